"""The system parameters: estimates of a training or of draws, how well they are determined, and over time."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.report.estimates import error_percent
from pinn_cli.runs.reading import read_table, undamaged
from pinn_cli.system.priors import HALF_WIDTH_90
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.estimate import Estimate, ParameterEstimate, Story
from pinn_cli.training.reported.parameter_posterior import CENTRAL_90

if TYPE_CHECKING:
    from pinn_cli.model.knowledge import Model
    from pinn_cli.posterior.posterior import PosteriorSamples
    from pinn_cli.system.parameters import Parameter

ESTIMATE = ("estimate", "std", "lower_90", "upper_90")

PARAMETER_COLUMNS = (
    "parameter", "true", "prescribed", "start", "estimate", "error_percent", "std", "lower_90", "upper_90",
)  # fmt: skip
OVER_TIME = "parameters_over_time.csv"
OVER_TIME_COLUMNS = (
    "record", "run", "parameter", "unit", *ESTIMATE, "alone", "alone_std", "change", "change_std", "chance", "changed",
)  # fmt: skip
DIAGNOSTICS = ("parameter", "mean", "std", "lower_90", "upper_90", "r_hat", "ess_bulk", "ess_tail", "mcse_mean")
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


def estimate_rows(estimates: Iterable[ParameterEstimate]) -> pd.DataFrame:
    """``parameter``, ``estimate``, ``std``, ``lower_90`` and ``upper_90``, one row each."""
    rows = [(p.name, p.estimate, p.std, p.lower_90, p.upper_90) for p in estimates]
    return pd.DataFrame(rows, columns=["parameter", *ESTIMATE])


def parameter_table(
    estimates: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None = None
) -> pd.DataFrame:
    """One row per system parameter (the content of ``parameters.csv``): `PARAMETER_COLUMNS`.

    ``true`` has values (members,) by kind; None of a record from a rig. A parameter was either prescribed or is unknown
    and has a ``start``, the value at which its search began. Cells of what is not known are empty (NaN).
    """
    table = estimate_rows(estimates)
    table["true"] = np.array([true_value(p.parameter, true) for p in estimates], dtype=float)
    table["prescribed"], table["start"] = [p.believed for p in estimates], [p.start for p in estimates]
    table["error_percent"] = error_percent(table["estimate"].to_numpy(float), table["true"].to_numpy(float))
    return table[list(PARAMETER_COLUMNS)]


def true_value(parameter: Parameter, true: Mapping[str, np.ndarray] | None) -> float:
    """The true value of a parameter; NaN where it is unknown."""
    values = None if true is None else true.get(parameter.kind)
    return float("nan") if values is None else float(values[parameter.index])


def parameter_estimates(samples: PosteriorSamples, parameters: Sequence[Parameter]) -> list[ParameterEstimate]:
    """Mean, standard deviation and central 90 % interval of every parameter in all chains, all of them unknown."""
    draws = samples.pooled
    lower, upper = np.quantile(draws, CENTRAL_90, axis=0)
    rows = np.stack((draws.mean(axis=0), draws.std(axis=0, ddof=1), lower, upper), axis=1).tolist()
    believed = zip(parameters, samples.prior.std(axis=0, ddof=1).tolist(), strict=True)
    unknown = [replace(parameter, prior_std=prior_std, unknown=True) for parameter, prior_std in believed]
    return [ParameterEstimate(parameter, *row) for parameter, row in zip(unknown, rows, strict=True)]


def posterior_correlation(draws: np.ndarray) -> np.ndarray:
    """(p, p) of draws (draws, p); NaN beside a parameter that does not move, 1 on the diagonal."""
    centred = draws - draws.mean(axis=0)
    length = np.linalg.norm(centred, axis=0)
    moving = np.where(length > 0.0, length, np.nan)
    correlation: np.ndarray = centred.T @ centred / np.outer(moving, moving)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def worst_sampled(diagnostics: pd.DataFrame, most: int) -> list[str]:
    """The ``most`` parameters with the fewest effective draws, in their own order."""
    effective = diagnostics[["ess_bulk", "ess_tail"]].min(axis=1)
    kept = effective.sort_values(kind="stable").index[:most].sort_values()
    return [str(name) for name in diagnostics.loc[kept, "parameter"]]


def identifiability_table(parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None) -> pd.DataFrame:
    """One row per parameter, unknown or prescribed (the content of ``identifiability.csv``).

    ``prior_std`` and ``std`` are in the parameter's unit, ``std_ratio`` is std / prior_std, ``relative_std_percent`` is
    100 std / |estimate|, ``largest_correlation`` has its sign and is that with the parameter ``correlated_with``. What
    is not known is empty (NaN or None); ``correlation`` (p, p) is None where the training gives none.
    """
    warnings: dict[str, list[str]] = {p.name: _individual_warning(p) for p in parameters}
    for p, warning in _inseparable(parameters, correlation):
        warnings[p.name].append(warning)
    rows = [
        {
            "parameter": p.name, "prior_std": p.prior_std, "std": p.std, "std_ratio": _ratio(p.std, p.prior_std),
            "relative_std_percent": 100.0 * _ratio(p.std, p.estimate), "largest_correlation": value,
            "correlated_with": None if other is None else parameters[other].name,
            "verdict": "; ".join(warnings[p.name]) or WELL_DETERMINED,
        }
        for p, (other, value) in zip(parameters, _nearest(correlation, len(parameters)), strict=True)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def identifiability_warnings(parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None) -> list[str]:
    """What a reader must know before trusting the unknown parameters, one sentence each; none if all is well.

    Arguments are those of :func:`identifiability_table`.
    """
    unknown = [p for p in parameters if p.unknown]
    if unknown and not any(np.isfinite(p.std) for p in unknown):
        return ["this training gives no standard deviations: nothing tells how far to trust the unknown ones"]
    individual = [warning for p in unknown if not p.parameter.curve for warning in _individual_warning(p)]
    shared = dict.fromkeys(said for p, said in _inseparable(parameters, correlation) if not p.parameter.curve)
    return [*individual, *shared]


def _individual_warning(p: ParameterEstimate) -> list[str]:
    """The gravest thing to be said of one parameter, regardless of the others; nothing if it is well determined."""
    ratio, relative = _ratio(p.std, p.prior_std), _ratio(p.std, p.estimate)
    of_value = f"its standard deviation is {100.0 * relative:.0f} % of its value"
    of_prior = f"{100.0 * ratio:.0f} % of the prior's"
    if not np.isfinite(p.std):
        return [f"{p.name} has no standard deviation: this training gives none"]
    if p.unknown and p.held:
        bound = f"all that is known is that it is below {p.upper_90:.3g} (95 %)"
        return [f"{p.name} is held at its lower bound of 0: {bound}"]
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
    well_known = [_ratio(p.std, p.estimate) <= KNOWN_WELL_ENOUGH for p in parameters]
    for i, j in np.argwhere(np.abs(correlation) > INSEPARABLE):
        p, other = parameters[i], parameters[j]
        if i == j or not p.unknown or well_known[i] or well_known[j]:
            continue
        value = f"(correlation {correlation[i, j]:.2f})"
        first, second = (p, other) if i < j else (other, p)
        together = f"{first.name} and {second.name} can hardly be told apart {value}: only a combination is known"
        yield p, together if other.unknown else f"{p.name} is known only as well as the prescribed {other.name} {value}"


def _nearest(correlation: np.ndarray | None, count: int) -> list[tuple[int | None, float]]:
    """Position of the other parameter with the largest |correlation|, and that correlation with its sign."""
    if correlation is None or count < 2:
        return [(None, np.nan)] * count
    others = np.where(np.eye(count, dtype=bool) | ~np.isfinite(correlation), 0.0, correlation)
    return [(int(j), float(others[i, j])) for i, j in enumerate(np.abs(others).argmax(axis=1))]


def _ratio(part: float, whole: float) -> float:
    """|part / whole|; NaN where there is nothing to divide by."""
    return abs(part / whole) if whole else np.nan


def story_table(stories: Sequence[Story]) -> pd.DataFrame:
    """One row per story of a record and parameter, the story that is reported first (the content of ``stories.csv``).

    The NMSE are a story's own, the same for all its parameters.
    """
    tables = []
    for story in stories:
        own = {"free_run_nmse_percent": story.free_run, "segments_nmse_percent": story.segments}
        tables.append(estimate_rows(story.parameters).assign(**own))
        tables[-1].insert(0, "story", story.name)
    return pd.concat(tables, ignore_index=True)


def parameters_over_time(model: Model, estimate: Estimate, run: str) -> pd.DataFrame | None:
    """One row per record and parameter (the content of ``parameters_over_time.csv``): `OVER_TIME_COLUMNS`.

    ``record`` counts from 1. ``estimate``, ``std`` and the 90 % interval are what is known after the record; ``alone``
    what the record says by itself. Of a parameter that changed, ``change`` is by how much if nothing else did that is
    not named, and ``chance`` the probability that uncertainty alone makes so much of it. None where nothing was
    compared with the model that was the record's prior, and whose history goes on.
    """
    if estimate.changes is None:
        return None
    before = history(model)
    rows = _over_time_rows(int(before["record"].max()) + 1, run, estimate, model.parameters)
    return pd.concat([before, rows], ignore_index=True)


def window_rows(number: int, run: str, estimate: Estimate) -> pd.DataFrame:
    """The rows of one window of a record, counted among the records before it and the windows."""
    parameters = [p.parameter for p in estimate.parameters if p.kind not in CALIBRATION_UNITS]
    return _over_time_rows(number, run, estimate, parameters)


def _over_time_rows(number: int, run: str, estimate: Estimate, wanted: Collection[Parameter]) -> pd.DataFrame:
    """Those of one record, of the parameters that are wanted."""
    changes = estimate.changes
    kept = [i for i, p in enumerate(estimate.parameters) if p.parameter in wanted]
    estimates = [estimate.parameters[i] for i in kept]
    table = estimate_rows(estimates).assign(
        record=number, run=run, unit=[p.parameter.unit for p in estimates], changed=False
    )
    table = table.reindex(columns=list(OVER_TIME_COLUMNS))
    if changes is not None:
        table["alone"], table["alone_std"] = changes.alone[kept], changes.alone_std[kept]
        for change in changes.found:
            moved = [changes.parameters[i] == change.parameter for i in kept]
            said = change.by, change.std, change.chance, True
            table.loc[moved, ["change", "change_std", "chance", "changed"]] = said
    return table


def history(model: Model) -> pd.DataFrame:
    """The rows of earlier records: those that lie beside the model, or of a first one the model's own.

    Raises:
        InputError: Those beside the model are damaged.
    """
    file = model.directory / OVER_TIME
    if file.is_file():
        numbers = tuple(name for name in OVER_TIME_COLUMNS if name not in ("run", "parameter", "unit", "changed"))
        with undamaged("model", model.directory):
            return read_table(file, numbers, OVER_TIME_COLUMNS)
    mean, covariance = model.used
    half = HALF_WIDTH_90 * (std := np.sqrt(np.diag(covariance)))
    rows = zip(model.parameters, mean, std, np.maximum(mean - half, model.lower), mean + half, strict=True)
    table = estimate_rows(ParameterEstimate(p, *numbers) for p, *numbers in rows)
    table = table.assign(record=1, run=model.directory.name, unit=[p.unit for p in model.parameters], changed=False)
    return table.reindex(columns=list(OVER_TIME_COLUMNS))
