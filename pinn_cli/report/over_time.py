"""Every parameter from record to record."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.runs.reading import DamagedError, read_table
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.central_interval import HALF_WIDTH_90

if TYPE_CHECKING:
    from pinn_cli.model.knowledge import Model
    from pinn_cli.system.parameters import Parameter
    from pinn_cli.training.estimate import Estimate

FILE = "parameters_over_time.csv"
COLUMNS = (
    "record", "run", "parameter", "unit", "estimate", "std", "lower_90", "upper_90", "alone", "alone_std", "change",
    "change_std", "chance", "changed",
)  # fmt: skip
_NUMBERS = (
    "record", "estimate", "std", "lower_90", "upper_90", "alone", "alone_std", "change", "change_std", "chance",
)  # fmt: skip


def parameters_over_time(model: Model, estimate: Estimate, run: str) -> pd.DataFrame | None:
    """One row per record and parameter (the content of ``parameters_over_time.csv``): `COLUMNS`.

    ``record`` counts from 1. ``estimate``, ``std`` and the 90 % interval are what is known after the record; ``alone``
    what the record says by itself. Of a parameter that changed, ``change`` is by how much if nothing else did that is
    not named, and ``chance`` the probability that uncertainty alone makes so much of it. None where nothing was
    compared with the model that was the record's prior, and whose history goes on.
    """
    if estimate.changes is None:
        return None
    before = history(model)
    own = _rows(int(before["record"].max()) + 1, run, estimate, model.parameters)
    return pd.concat([before, own], ignore_index=True)


def window_rows(number: int, run: str, estimate: Estimate) -> pd.DataFrame:
    """The rows of one window of a record, counted among the records before it and the windows."""
    own = [found.parameter for found in estimate.parameters if found.kind not in CALIBRATION_UNITS]
    return _rows(number, run, estimate, own)


def history(model: Model) -> pd.DataFrame:
    """The rows of earlier records: those that lie beside the model, or of a first one the model's own."""
    file = model.directory / FILE
    if file.is_file():
        try:
            table = read_table(file, _NUMBERS, COLUMNS)
            if list(table.columns) == list(COLUMNS) and len(table) and table["record"].between(0, 1e9).all():
                return table
        except DamagedError:
            pass
        hint = f"{FILE} in it is damaged; without that file the history begins with this run"
        raise InputError("model", model.directory, "a run with the history that it wrote", hint)
    mean, covariance = model.known.within(model.lower)
    rows = []
    for p, value, std, bound in zip(model.parameters, mean, np.sqrt(np.diag(covariance)), model.lower, strict=True):
        lower, upper = max(value - HALF_WIDTH_90 * std, bound), value + HALF_WIDTH_90 * std
        known = {"estimate": value, "std": std, "lower_90": lower, "upper_90": upper, "changed": False}
        rows.append({"record": 1, "run": model.directory.name, "parameter": p.name, "unit": p.unit, **known})
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(number: int, run: str, estimate: Estimate, wanted: Collection[Parameter]) -> pd.DataFrame:
    """Those of one record, of the parameters that are wanted."""
    changes, rows = estimate.changes, []
    for i, p in enumerate(estimate.parameters):
        if p.parameter not in wanted:
            continue
        row: dict[str, Any] = {"record": number, "run": run, "parameter": p.name, "unit": p.parameter.unit}
        row |= {"estimate": p.estimate, "std": p.std, "lower_90": p.lower_90, "upper_90": p.upper_90, "changed": False}
        if changes is not None:
            row |= {"alone": changes.alone[i], "alone_std": changes.alone_std[i]}
            for change in changes.found:
                if changes.parameters[i] == change.parameter:
                    moved = {"change": change.by, "change_std": change.std, "chance": change.chance}
                    row |= {**moved, "changed": True}
        rows.append(row)
    return pd.DataFrame(rows, columns=list(COLUMNS))
