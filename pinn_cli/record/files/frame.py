"""Columns that Python holds in memory: a pandas DataFrame, or arrays by name (``data=frame``)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.files.file_format import FileFormat
from pinn_cli.record.files.table import IN_BRACKETS, TIME_COLUMN, SensorHint, Table, asked_for, bare, is_called_times
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

DATA_SETTING = "data"
TABLES_ALLOWED = "a pandas DataFrame, or a map of names to arrays of one length"

# What this process holds, by the name that stands for it in `data.path`.
_held: dict[str, Table] = {}


class FrameFormat(FileFormat):
    """What :func:`held` holds, by the name in the place of a file's."""

    name = "frame"
    suffixes = ()

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        table = _held.get(path.name)
        if table is None:
            hint = "a frame is in the memory of one process: pinn_cli.run(..., data=frame); other processes need a file"
            raise InputError("data.path", path.name, "a frame that this process holds", hint)
        asked_for(path, wanted or {}, list(table.columns))
        return table


@contextmanager
def held(table: Table) -> Iterator[None]:
    """Have a run read a table by its name within the block."""
    name = table.path.name
    before = _held.get(name)
    _held[name] = table
    try:
        yield
    finally:
        if before is None:
            del _held[name]


def table_of(data: Any, setting: str = DATA_SETTING) -> Table:
    """A table whose name says its content.

    Args:
        data: A DataFrame, whose index is the column ``t`` where it has times; or names to arrays: a matrix ``acc`` of
            several columns becomes ``acc.1``, ``acc.2`` and so on. Units stand in brackets at the end of a name
            (``a1 (g)``), in ``data.attrs["units"]`` by column, or are those of pint's quantities.
        setting: What it is called in errors.

    Raises:
        InputError: It is something else, its columns differ in length or have one name.
    """
    is_frame = all(hasattr(data, name) for name in ("columns", "index", "attrs"))
    columns, units = _of_frame(data) if is_frame else _of_arrays(data, setting)
    if not columns:
        raise InputError(setting, type(data).__name__, TABLES_ALLOWED, "it has no columns")
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name!r}: {length}" for name, length in lengths.items())
        raise InputError(setting, shown, "arrays of one length", "channels of different rates go into several frames")
    import pandas as pd

    cells = {name: pd.Series(values).reset_index(drop=True) for name, values in columns.items()}
    in_brackets = {name: match["unit"] for name in cells if (match := IN_BRACKETS.fullmatch(name))}
    column_units = {name: units.get(name) or units.get(bare(name)) or in_brackets.get(name, "") for name in cells}
    return named_by_content(Table.of_cells(Path(), cells, column_units))


def named_by_content(table: Table) -> Table:
    """The same under a name that says its content."""
    digest = hashlib.sha256()  # the same for the same content alone: the name makes a run's identity
    for name, numbers in table.columns.items():
        unit = table.hints.get(name, SensorHint()).unit
        digest.update(repr((name, unit, len(numbers), sorted(table.odd_cells[name].items()))).encode())
        digest.update(np.ascontiguousarray(numbers).tobytes())
    return replace(table, path=Path(f"frame-{digest.hexdigest()[:16]}"))


def _of_frame(frame: pd.DataFrame) -> tuple[dict[str, Any], dict[str, str]]:
    """Columns, and the units that are told; an index that says when samples were taken is the column of times."""
    names = [_joined(name) for name in frame.columns]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(DATA_SETTING, repr(name), "a frame whose columns have different names")
    columns: dict[str, Any] = {name: frame.iloc[:, i] for i, name in enumerate(names)}
    has_times = any(map(is_called_times, names))
    if not has_times and (is_called_times(str(frame.index.name)) or frame.index.dtype.kind in "fmM"):
        columns = {TIME_COLUMN: frame.index.to_series(), **columns}
    units = frame.attrs.get("units")
    return columns, {name: str(unit or "") for name, unit in units.items()} if isinstance(units, Mapping) else {}


def _of_arrays(data: Any, setting: str) -> tuple[dict[str, Any], dict[str, str]]:
    if not isinstance(data, Mapping):
        raise InputError(setting, f"<{type(data).__name__}>", TABLES_ALLOWED)
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for key, values in data.items():
        name, unit = _joined(key), getattr(values, "units", None)
        array = values.magnitude if unit is not None and hasattr(values, "magnitude") else values
        array = np.asarray(array) if not hasattr(array, "dtype") or isinstance(array, np.ndarray) else array
        if array.ndim not in (1, 2):
            shown = f"an array of shape {array.shape}"
            raise InputError(f"{setting}[{name!r}]", shown, "a vector or (samples, channels)")
        parts = {name: array} if array.ndim == 1 else {f"{name}.{j + 1}": array[:, j] for j in range(array.shape[1])}
        columns |= parts
        units |= dict.fromkeys(parts, "" if unit is None else str(unit))
    return columns, units


def _joined(name: Any) -> str:
    """A column's name as text; that of several levels, ("acceleration", 3), is ``acceleration.3``."""
    return ".".join(map(str, name)) if isinstance(name, tuple) else str(name)
