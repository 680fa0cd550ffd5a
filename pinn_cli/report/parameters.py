"""The tables of system parameters: estimates with their uncertainty, and how well the record determines them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.report.results import with_labels
from pinn_cli.training.central_interval import HALF_WIDTH_90

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from pinn_cli.system.parameters import Parameter
    from pinn_cli.training.estimate import ParameterEstimate

PARAMETER_COLUMNS = (
    "parameter", "true", "prescribed", "start", "estimate", "error_percent", "std", "lower_90", "upper_90",
)  # fmt: skip
IDENTIFIABILITY_COLUMNS = (
    "parameter", "prior_std", "std", "std_ratio", "relative_std_percent", "largest_correlation", "correlated_with",
    "verdict",
)  # fmt: skip
WELL_DETERMINED = "well determined"

# Posterior over prior standard deviation, r: of what is known about a parameter (its precision) the prior brings r^2.
# At 0.5 that is a quarter. A prior that is cut off at zero, one standard deviation below its mean, has 0.79 of its
# deviation left before any record is seen: from 0.75 on a record need not have said anything.
LEANS_ON_PRIOR, PRIOR_UNTOUCHED = 0.5, 0.75

# Standard deviation over value. At 0.25 the 90 % interval is 82 % of the value wide: the order of magnitude is known,
# not the parameter.
POORLY_DETERMINED = 0.25

# At a correlation of 0.95, knowing one of the two would make the other's standard deviation three times smaller.
INSEPARABLE = 0.95

# Standard deviation over value up to which a parameter is known well enough, whatever shares its error: a stiffness is
# rarely prescribed better. Without this, a good record with parameters known to 0.1 % would warn of their correlation.
KNOWN_WELL_ENOUGH = 0.05


def parameter_table(
    estimates: Iterable[ParameterEstimate], true: Mapping[str, np.ndarray] | None, labels: Mapping[str, object]
) -> pd.DataFrame:
    """One row per system parameter (the content of ``parameters.csv``).

    Args:
        estimates: One per parameter.
        true: Kind to values (members,), or None where the truth is unknown (a record from a rig).
        labels: A value for each of `pinn_cli.report.results.LABELS`.

    Returns:
        Columns: the labels and `PARAMETER_COLUMNS`. ``error_percent`` is 100 |estimate - true| / |true|, as in the
        paper's tables; it is empty (NaN) where the truth is unknown or zero. A parameter was either prescribed or is
        unknown and has a ``start``, the value at which its search began: the other column is empty.
    """
    rows = []
    for given in estimates:
        truth = true_value(given.parameter, true)
        error = 100.0 * abs(given.estimate - truth) / abs(truth) if truth else np.nan
        given_as = (given.believed, given.start)
        rows.append((given.name, truth, *given_as, given.estimate, error, given.std, given.lower_90, given.upper_90))
    return with_labels(pd.DataFrame(rows, columns=list(PARAMETER_COLUMNS)), labels)


def true_value(parameter: Parameter, true: Mapping[str, np.ndarray] | None) -> float:
    """The true value of a parameter; NaN where it is unknown."""
    values = None if true is None else true.get(parameter.kind)
    return float("nan") if values is None else float(values[parameter.index])


def any_unknown(parameters: Sequence[ParameterEstimate]) -> bool:
    """Whether there is a parameter that was to be identified from the record alone."""
    return any(p.unknown for p in parameters)


def identifiability_table(
    parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None, labels: Mapping[str, object]
) -> pd.DataFrame:
    """One row per parameter, unknown or prescribed (the content of ``identifiability.csv``).

    Args:
        parameters: All that were estimated, p of them.
        correlation: (p, p), their posterior correlation; None where the training gives none.
        labels: A value for each of `pinn_cli.report.results.LABELS`.

    Returns:
        Columns: the labels and `IDENTIFIABILITY_COLUMNS`. ``prior_std`` and ``std`` are in the parameter's unit,
        ``std_ratio`` is std / prior_std, ``relative_std_percent`` is 100 std / |estimate|, ``largest_correlation`` has
        its sign and is that with the parameter ``correlated_with``. What is not known is empty (NaN or None).
    """
    neighbours = _nearest(correlation, len(parameters))
    warnings: dict[str, list[str]] = {p.name: _own_warning(p) for p in parameters}
    for p, warning in _inseparable(parameters, correlation):
        warnings[p.name].append(warning)
    rows = [
        (
            p.name, p.prior_std, p.std, _ratio(p.std, p.prior_std), 100.0 * _ratio(p.std, p.estimate), value,
            None if other is None else parameters[other].name, "; ".join(warnings[p.name]) or WELL_DETERMINED,
        )
        for p, (other, value) in zip(parameters, neighbours, strict=True)
    ]  # fmt: skip
    return with_labels(pd.DataFrame(rows, columns=list(IDENTIFIABILITY_COLUMNS)), labels)


def correlation_table(parameters: Sequence[ParameterEstimate], correlation: np.ndarray) -> pd.DataFrame:
    """The posterior correlation with the parameters' names (the content of ``correlation.csv``).

    Args:
        parameters: p of them.
        correlation: (p, p), in their order.

    Returns:
        A column ``parameter`` and one per parameter, p rows.
    """
    names = [p.name for p in parameters]
    table = pd.DataFrame(correlation, columns=names)
    table.insert(0, "parameter", names)
    return table


def identifiability_warnings(parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None) -> list[str]:
    """What a reader must know before trusting the unknown parameters, one sentence each; none if all is well.

    Args:
        parameters: p of them; only the unknown ones are judged.
        correlation: (p, p), in their order; None where the training gives none.
    """
    unknown = [p for p in parameters if p.unknown]
    if unknown and not any(np.isfinite(p.std) for p in unknown):
        return ["this training gives no standard deviations: nothing tells how far to trust the unknown ones"]
    own = [warning for p in unknown for warning in _own_warning(p)]
    shared = dict.fromkeys(warning for _, warning in _inseparable(parameters, correlation))
    return [*own, *shared]


def _own_warning(p: ParameterEstimate) -> list[str]:
    """The gravest thing to be said of one parameter, regardless of the others; nothing if it is well determined."""
    ratio, relative = _ratio(p.std, p.prior_std), _ratio(p.std, p.estimate)
    of_value, of_prior = (
        f"its standard deviation is {_percent(relative)} of its value",
        f"{_percent(ratio)} of the prior's",
    )
    if not np.isfinite(p.std):
        return [f"{p.name} has no standard deviation: this training gives none"]
    if p.unknown and p.held:
        known = f"all that is known is that it is below {p.upper_90:.3g} (95 %)"
        return [f"{p.name} is held at its lower bound of 0: {known}"]
    if not p.unknown and ratio > LEANS_ON_PRIOR:
        return [f"{p.name} rests on its prescribed value: its standard deviation is {of_prior}"]
    if ratio > PRIOR_UNTOUCHED:
        return [f"the record says nearly nothing about {p.name}: its standard deviation is still {of_prior}"]
    if abs(p.estimate) <= HALF_WIDTH_90 * p.std or p.lower_90 <= 0.0 <= p.upper_90:
        return [f"{p.name} cannot be told from zero: {of_value}"]
    if relative > POORLY_DETERMINED:
        return [f"{p.name} is poorly determined: {of_value}"]
    if ratio > LEANS_ON_PRIOR:
        return [f"{p.name} leans on its prior: the record narrows its standard deviation only to {of_prior}"]
    return []


def _inseparable(
    parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None
) -> Iterator[tuple[ParameterEstimate, str]]:
    """Every unknown parameter that another one can stand in for, and what to say of the two.

    Two unknown parameters come twice, once from either side, with the same words.
    """
    if correlation is None:
        return
    for i, j in np.argwhere(np.abs(correlation) > INSEPARABLE):
        p, other = parameters[i], parameters[j]
        if i == j or not p.unknown or _known_well_enough(p) or _known_well_enough(other):
            continue
        value = f"(correlation {correlation[i, j]:.2f})"
        if other.unknown:
            first, second = (p, other) if i < j else (other, p)
            warning = f"{first.name} and {second.name} can hardly be told apart {value}: only a combination is known"
        else:
            warning = f"{p.name} is known only as well as the prescribed {other.name} {value}"
        yield p, warning


def _known_well_enough(p: ParameterEstimate) -> bool:
    return _ratio(p.std, p.estimate) <= KNOWN_WELL_ENOUGH


def _nearest(correlation: np.ndarray | None, count: int) -> list[tuple[int | None, float]]:
    """Position of the other parameter with the largest |correlation|, and that correlation with its sign."""
    if correlation is None or count < 2:
        return [(None, np.nan)] * count
    others = np.where(np.eye(count, dtype=bool) | ~np.isfinite(correlation), 0.0, correlation)
    nearest = np.abs(others).argmax(axis=1)
    return [(int(j), float(others[i, j])) for i, j in enumerate(nearest)]


def _ratio(part: float, whole: float) -> float:
    """|part / whole|; NaN where there is nothing to divide by."""
    return abs(part / whole) if whole else np.nan


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
