"""Every parameter from record to record, and what changed."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.central_interval import HALF_WIDTH_90

if TYPE_CHECKING:
    from pinn_cli.model.model import Model
    from pinn_cli.system.parameters import Parameter
    from pinn_cli.training.estimate import Changes, Estimate

FILE = "parameters_over_time.csv"
COLUMNS = (
    "record", "run", "parameter", "unit", "estimate", "std", "lower_90", "upper_90", "alone", "alone_std", "change",
    "change_std", "chance", "changed",
)  # fmt: skip


def parameters_over_time(model: Model, estimate: Estimate, run: str) -> pd.DataFrame | None:
    """One row per record and parameter (the content of ``parameters_over_time.csv``).

    Args:
        model: What the record's prior was; the history in its directory goes on.
        estimate: Of the record.
        run: Name of its run.

    Returns:
        Columns: `COLUMNS`. ``record`` counts from 1. ``estimate``, ``std`` and the 90 % interval are what is known
        after the record; ``alone`` what the record says by itself. Of a parameter that changed, ``change`` is by how
        much if nothing else did that is not named, and ``chance`` the probability that uncertainty alone makes so much
        of it. None where nothing was compared.
    """
    if estimate.changes is None:
        return None
    before = history(model)
    own = _rows(int(before["record"].max()) + 1, run, estimate, model.parameters)
    return pd.concat([before, own], ignore_index=True)


def window_rows(number: int, run: str, estimate: Estimate) -> pd.DataFrame:
    """The rows of one window of a record, with the same columns.

    Args:
        number: Of the window, among the records before it and the windows.
        run: What it is called.
        estimate: Of it.
    """
    own = [found.parameter for found in estimate.parameters if found.kind not in CALIBRATION_UNITS]
    return _rows(number, run, estimate, own)


def _rows(number: int, run: str, estimate: Estimate, wanted: Collection[Parameter]) -> pd.DataFrame:
    """Those of one record, of the parameters that are wanted."""
    changes = estimate.changes
    rows = [
        _row(number, run, found.name, found.parameter.unit, (found.estimate, found.std, found.lower_90, found.upper_90))
        | ({} if changes is None else _compared(changes, i))
        for i, found in enumerate(estimate.parameters)
        if found.parameter in wanted
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def history(model: Model) -> pd.DataFrame:
    """The rows of earlier records: those that lie beside the model, or of a first one the model's own."""
    file = model.directory / FILE
    if file.is_file():
        try:
            table = pd.read_csv(file)
            if list(table.columns) == list(COLUMNS) and len(table):
                return table
        except (ValueError, OSError, pd.errors.ParserError):
            pass
        hint = f"{FILE} in it is damaged; without that file the history begins with this run"
        raise InputError("model", model.directory, "a run with the history that it wrote", hint)
    mean, covariance = model.known.within(model.lower)
    rows = []
    for p, value, s, bound in zip(model.parameters, mean, np.sqrt(np.diag(covariance)), model.lower, strict=True):
        interval = max(value - HALF_WIDTH_90 * s, bound), value + HALF_WIDTH_90 * s
        rows.append(_row(1, model.directory.name, p.name, p.unit, (value, s, *interval)))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _row(record: int, run: str, parameter: str, unit: str, found: tuple[float, ...]) -> dict[str, Any]:
    names = ("estimate", "std", "lower_90", "upper_90")
    row = {"record": record, "run": run, "parameter": parameter, "unit": unit, **dict(zip(names, found, strict=True))}
    return (
        row
        | {"alone": np.nan, "alone_std": np.nan, "change": np.nan, "change_std": np.nan, "chance": np.nan}
        | {"changed": False}
    )


def _compared(changes: Changes, i: int) -> dict[str, Any]:
    row: dict[str, Any] = {"alone": changes.alone[i], "alone_std": changes.alone_std[i]}
    for change in changes.found:
        if changes.parameters[i] == change.parameter:
            row |= {"change": change.by, "change_std": change.std, "chance": change.chance, "changed": True}
    return row


def changes_text(changes: Changes | None) -> str:
    """What a run prints of changes; "" where nothing was compared, and of a contradiction: the verdict tells it."""
    if changes is None or (not changes.found and changes.chance < changes.improbable):
        return ""
    if not changes.found:
        return f"no change since the earlier records (probability of such differences by chance: {changes.chance:.2g})"
    lines = []
    for change in changes.found:
        p = change.parameter
        value, std = 100.0 * change.by / p.prescribed, 100.0 * change.std / abs(p.prescribed)
        much = (
            f"by {value:+.2g} +- {std:.1g} %" if p.prescribed else f"by {change.by:+.3g} +- {change.std:.1g} {p.unit}"
        )
        lines.append(
            f"changed: {p.name} ({p.owner}) {much}; by chance {_probability(change.chance)};"
            f" {100.0 * change.share:.3g} % that it is this parameter"
        )
    return "\n".join(lines)


def _probability(chance: float) -> str:
    return f"{chance:.1g}" if chance >= 1e-12 else "below 1e-12"
