"""The table of system parameters: prescribed, estimated with its uncertainty, and true where known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.report.labels import with_labels
from pinn_cli.training.estimated_chain import split_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pinn_cli.training.estimate import ParameterEstimate

COLUMNS = ("parameter", "true", "prescribed", "start", "estimate", "error_percent", "std", "lower_90", "upper_90")


def parameter_table(
    estimates: Iterable[ParameterEstimate], true: Mapping[str, np.ndarray] | None, labels: Mapping[str, object]
) -> pd.DataFrame:
    """One row per system parameter (the content of ``parameters.csv``).

    Args:
        estimates: Named ``k_2``, ``kappa_4``: the symbol and the connection, counted from 1.
        true: Symbol to values (dof,), or None where the truth is unknown (a record from a rig).
        labels: A value for each of `pinn_cli.report.labels.LABELS`.

    Returns:
        Columns: the labels and `COLUMNS`. ``error_percent`` is 100 |estimate - true| / |true|, as in the paper's
        tables; it is empty (NaN) where the truth is unknown or zero. A parameter was either prescribed or is unknown
        and has a ``start``, the value at which its search began: the other column is empty.
    """
    rows = []
    for given in estimates:
        truth = true_value(given.name, true)
        error = 100.0 * abs(given.estimate - truth) / abs(truth) if truth else np.nan
        given_as = (given.believed, given.start)
        rows.append((given.name, truth, *given_as, given.estimate, error, given.std, given.lower_90, given.upper_90))
    return with_labels(pd.DataFrame(rows, columns=list(COLUMNS)), labels)


def true_value(name: str, true: Mapping[str, np.ndarray] | None) -> float:
    """The true value of the parameter called ``name``; NaN where it is unknown."""
    symbol, connection = split_name(name)
    values = None if true is None else true.get(symbol)
    return float("nan") if values is None else float(np.asarray(values)[connection - 1])
