"""Columns that Python holds in memory: a pandas DataFrame, or arrays by name (``data=frame``)."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.table import SensorHint, Table, check_names
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

SETTING = "data"
ALLOWED = "a pandas DataFrame, or a map of names to arrays of one length"
# What a column of times is called.
TIMES = ("t", "time")
# A unit in brackets at the end of a column's name.
_IN_BRACKETS = re.compile(r"(?P<name>.*\S)\s*[\[(]\s*(?P<unit>[^\[\]()]+?)\s*[\])]\s*$")

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
        check_names(path, wanted or {}, list(table.columns))
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


def table_of(data: Any, setting: str = SETTING) -> Table:
    """A table whose name says its content.

    Args:
        data: A DataFrame, whose index is the column ``t`` where it has times; or names to arrays: a matrix ``acc`` of
            several columns becomes ``acc.1``, ``acc.2`` and so on. Units stand in brackets at the end of a name
            (``a1 (g)``), in ``data.attrs["units"]`` by column, or are those of pint's quantities.
        setting: What it is called in errors.

    Raises:
        InputError: It is something else, its columns differ in length or have one name.
    """
    columns, units = _of_frame(data) if _is_frame(data) else _of_arrays(data, setting)
    if not columns:
        raise InputError(setting, type(data).__name__, ALLOWED, "it has no columns")
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name!r}: {length}" for name, length in lengths.items())
        raise InputError(setting, shown, "arrays of one length", "channels of different rates go into several frames")
    numbers, odd = {}, {}
    for name, values in columns.items():
        numbers[name], odd[name] = _numbers(values)
    hints = {name: SensorHint(unit) for name, unit in units.items() if unit and name in numbers}
    return Table(Path(_name_of(numbers, odd, hints)), numbers, odd, hints)


def bare(column: str) -> str:
    """The name of a column without a unit in brackets at its end."""
    found = _IN_BRACKETS.fullmatch(column)
    return found["name"] if found else column.strip()


def _is_frame(data: Any) -> bool:
    return hasattr(data, "columns") and hasattr(data, "index") and hasattr(data, "attrs")


def _of_frame(frame: pd.DataFrame) -> tuple[dict[str, Any], dict[str, str]]:
    """Columns and their units; an index that says when samples were taken is the column of times."""
    names = [_joined(name) for name in frame.columns]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(SETTING, repr(name), "a frame whose columns have different names")
    columns: dict[str, Any] = {name: frame.iloc[:, i] for i, name in enumerate(names)}
    has_times = any(bare(name) in TIMES for name in names)
    if not has_times and (frame.index.name in TIMES or frame.index.dtype.kind in "fmM"):
        columns = {TIMES[0]: frame.index.to_series(), **columns}
    told = frame.attrs.get("units")
    return columns, _units(columns, told if isinstance(told, Mapping) else {})


def _of_arrays(data: Any, setting: str) -> tuple[dict[str, Any], dict[str, str]]:
    if not isinstance(data, Mapping):
        raise InputError(setting, f"<{type(data).__name__}>", ALLOWED)
    columns: dict[str, Any] = {}
    told: dict[str, str] = {}
    for key, values in data.items():
        name, unit = _joined(key), getattr(values, "units", None)
        array = values.magnitude if unit is not None and hasattr(values, "magnitude") else values
        array = np.asarray(array) if not hasattr(array, "dtype") or isinstance(array, np.ndarray) else array
        if array.ndim not in (1, 2):
            raise InputError(
                f"{setting}[{name!r}]", f"an array of shape {array.shape}", "a vector or (samples, channels)"
            )
        parts = {name: array} if array.ndim == 1 else {f"{name}.{j + 1}": array[:, j] for j in range(array.shape[1])}
        columns |= parts
        told |= {part: "" if unit is None else str(unit) for part in parts}
    return columns, _units(columns, told)


def _joined(name: Any) -> str:
    """A column's name as text; that of several levels, ("acceleration", 3), is ``acceleration.3``."""
    return ".".join(map(str, name)) if isinstance(name, tuple) else str(name)


def _units(columns: Mapping[str, Any], told: Mapping[str, Any]) -> dict[str, str]:
    """Of every column that says one: what is told, else what stands in brackets, of columns other than times."""
    found: dict[str, str] = {}
    for name in columns:
        if bare(name) in TIMES:
            continue
        in_brackets = _IN_BRACKETS.fullmatch(name)
        found[name] = str(told.get(name) or told.get(bare(name)) or (in_brackets["unit"] if in_brackets else ""))
    return found


def _numbers(values: Any) -> tuple[np.ndarray, dict[int, str]]:
    """Cells as float64, NaN of those that are empty or no number, and the latter as text by their rows."""
    import pandas as pd

    cells: pd.Series[Any] = pd.Series(values).reset_index(drop=True)
    kind = cells.dtype.kind
    if kind in "mM":
        since = cells - cells.iloc[0] if kind == "M" else cells
        return since.dt.total_seconds().to_numpy(dtype=np.float64), {}
    if kind == "c":
        return np.full(len(cells), np.nan), {i: str(cell) for i, cell in enumerate(cells)}
    numbers = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan, copy=True)
    if kind in "iuf":
        return np.ascontiguousarray(numbers), {}
    odd = [i for i in np.flatnonzero(cells.notna().to_numpy()) if isinstance(cells[i], bool) or np.isnan(numbers[i])]
    numbers[odd] = np.nan
    return numbers, {int(i): str(cells[i]) for i in odd}


def _name_of(
    columns: Mapping[str, np.ndarray], odd: Mapping[str, Mapping[int, str]], hints: Mapping[str, SensorHint]
) -> str:
    """A name that is the same for the same content alone, which makes a run's identity."""
    digest = hashlib.sha256()
    for name, values in columns.items():
        unit = hints[name].unit if name in hints else ""
        digest.update(repr((name, unit, len(values), sorted(odd[name].items()))).encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return f"frame-{digest.hexdigest()[:16]}"
