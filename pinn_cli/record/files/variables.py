"""Arrays of a file as columns: vectors by their name, a matrix's columns by its name and their number.

Columns of several clocks, or of several files, are put onto one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pinn_cli.record.files.table import (
    SensorHint,
    Table,
    check_names,
    column_of_times,
    is_called_times,
    rate_of,
)
from pinn_cli.settings.errors import InputError

NO_HINT = SensorHint()
# Times that differ by less than this part of the shortest step are the same.
SAME_TIME = 0.01
_OTHERS = {"b": "true or false", "c": "complex numbers", "S": "text", "U": "text", "M": "dates", "m": "durations"}


@dataclass(frozen=True, eq=False)
class Variable:
    """An array in a file, which may not have been read yet.

    Attributes:
        shape: As the program that wrote it shows it.
        load: Its numbers, of that shape.
        content: What it holds instead of real numbers, such as ``text``; "": it holds real numbers.
        hint: What the file says of it.
        time: Of its samples, (N,), s, where the file tells it.
    """

    shape: tuple[int, ...]
    load: Callable[[], np.ndarray]
    content: str = ""
    hint: SensorHint = NO_HINT
    time: np.ndarray | None = None

    @classmethod
    def of(cls, array: np.ndarray, unit: str = "") -> Variable:
        """Of an array that has been read, of whatever type."""
        return cls(array.shape, lambda: array, content_of(array.dtype), SensorHint(unit))

    @property
    def sides(self) -> tuple[int, ...]:
        """Lengths of the sides that are longer than 1."""
        return tuple(side for side in self.shape if side != 1)

    @property
    def columns(self) -> int:
        """How many columns it has: 1 of a vector, 0 of a scalar or of what is neither vector nor matrix."""
        if self.content or 0 in self.shape or len(self.sides) not in (1, 2):
            return 0
        return 1 if len(self.sides) == 1 else min(self.sides)

    @property
    def samples(self) -> int:
        """Length of each of them: of a matrix its longer side, which is time's."""
        return max(self.sides, default=0)

    def read(self) -> np.ndarray:
        """(columns, samples), float64, in native byte order."""
        array = np.atleast_2d(np.asarray(self.load()).astype(np.float64).reshape(self.sides))
        return array if array.shape[0] < array.shape[1] else array.T

    @property
    def described(self) -> str:
        """What it is; to be read after ``it``."""
        shape = " × ".join(map(str, self.shape)) or "1 × 1"
        return f"holds {self.content}, which pinn-run does not evaluate" if self.content else f"is {shape}"


def content_of(dtype: np.dtype) -> str:
    """What arrays of a type hold; "" of real numbers."""
    return "" if dtype.kind in "iuf" else _OTHERS.get(dtype.kind, "text or objects")


def tables_of(path: Path, variables: Mapping[str, Variable], wanted: Mapping[str, str] | None) -> list[Table]:
    """The columns that are asked for, one table for each clock.

    Column j, from 1, of the matrix ``acc`` is ``acc.1``, ``acc.2`` and so on. Where none is asked for, they are those
    that have times, and of others those of the length that most have. Where none is called as times are, a scalar such
    as ``fs`` or ``dt`` tells them.

    Raises:
        InputError: Naming the setting: there is no such variable, or it is no vector of numbers; or the columns differ
            in length.
    """
    places = {column: (v, j) for name, v in variables.items() for j, column in enumerate(_columns_of(name, v))}
    first: dict[tuple[Variable, int], str] = {}
    distinct = [column for column, place in places.items() if first.setdefault(place, column) == column]
    rate = None if any(map(is_called_times, distinct)) else _rate(variables)
    if wanted is not None:
        by_name = {setting: column or column_of_times(distinct) for setting, column in wanted.items()}
        wanted = {setting: column for setting, column in by_name.items() if wanted[setting] or rate is None}
    for setting, column in (wanted or {}).items():
        if column not in places:
            _refuse(path, setting, column, variables, distinct)
    if wanted is None:
        timeless = [places[column][0].samples for column in distinct if places[column][0].time is None]
        usual = max(timeless, key=lambda length: (timeless.count(length), length), default=0)
        names = [
            column for column in distinct if places[column][0].time is not None or places[column][0].samples == usual
        ]
    else:
        names = list(wanted.values())
    clocks: dict[bytes, dict[str, Variable]] = {}
    for column in names:
        variable = places[column][0]
        clocks.setdefault(b"" if variable.time is None else variable.time.tobytes(), {})[column] = variable
    if b"" in clocks:  # nothing tells when they were taken with respect to each other
        clocks = {b"": {column: places[column][0] for column in names}}
    read = {variable: variable.read() for of_clock in clocks.values() for variable in of_clock.values()}
    tables = []
    for clock, of_clock in clocks.items():
        columns = {name: np.ascontiguousarray(read[variable][places[name][1]]) for name, variable in of_clock.items()}
        _check_lengths(path, columns)
        hints = {name: variable.hint for name, variable in of_clock.items() if variable.hint != NO_HINT}
        tables.append(Table(path, columns, {}, hints, np.frombuffer(clock) if clock else None))
    if rate is not None and len(tables) == 1 and tables[0].time is None:
        tables = [replace(tables[0], time=np.arange(len(tables[0])) / rate)]
    return tables or [Table(path, {})]


def _check_lengths(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        short, long = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        shown = f"{lengths[short]} samples of {short!r}, {lengths[long]} of {long!r}"
        hint = "channels of different rates? Put those of one rate into one file, with their times"
        raise InputError(path.name, shown, "columns of one length", hint)


def _rate(variables: Mapping[str, Variable]) -> float | None:
    """Hz, as a scalar of the file says."""
    for name, variable in variables.items():
        last = re.split(r"[./]", name)[-1]
        if rate_of(last, 1.0) is not None and not variable.content and math.prod(variable.shape) == 1:
            rate = rate_of(last, float(np.asarray(variable.load()).ravel()[0]))
            if rate is not None:
                return rate
    return None


def _columns_of(name: str, variable: Variable) -> list[str]:
    count = variable.columns
    return [name] if count == 1 else [f"{name}.{j}" for j in range(1, count + 1)]


def _refuse(path: Path, setting: str, name: str, variables: Mapping[str, Variable], columns: list[str]) -> None:
    """Say why there is no such column."""
    root = name if name in variables else name.rpartition(".")[0]
    if root in variables:
        allowed = "a column of numbers: a vector, or a channel of a matrix, counted from 1, such as acc.2"
        raise InputError(setting, repr(name), allowed, f"in {path.name} {root!r} {variables[root].described}")
    within = next((other for other in variables if other.startswith((f"{name}.", f"{name}/"))), "")
    check_names(path, {setting: name}, columns, within and f"name one of its fields, such as {within}")


def joined(tables: Sequence[Table], times: Sequence[np.ndarray], without: Sequence[str] = ()) -> Table:
    """One table over all the times that there are, with ``sources``; a column is NaN at times that it has no sample of.

    Args:
        tables: Their columns have different names.
        times: Of each table's samples, (N,), s, increasing, on the same clock.
        without: Columns that are left out: those of the times.

    Raises:
        InputError: The clocks do not overlap, or two tables have a column of the same name.
    """
    _check_overlap(tables, times)
    time, places = _union(times)
    columns: dict[str, np.ndarray] = {}
    sources: dict[str, tuple[Table, np.ndarray]] = {}
    odd: dict[str, dict[int, str]] = {}
    for table, here in zip(tables, places, strict=True):
        rows = np.full(len(time), -1)
        rows[here] = np.arange(len(here))
        for name in (name for name in table.columns if name not in without):
            if name in columns:
                shown = f"{sources[name][0].path.name}, {table.path.name}"
                raise InputError("data.path", shown, "files whose columns have different names", f"{name!r} is in both")
            columns[name] = np.where(rows >= 0, table.columns[name][rows], np.nan)
            odd[name] = {int(here[row]): text for row, text in table.odd_cells.get(name, {}).items()}
            sources[name] = table, rows
    hints = {name: hint for table in tables for name, hint in table.hints.items()}
    return Table(tables[0].path, columns, odd, hints, time, sources=sources)


def _union(times: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """All times, those that are the same once; and of each sequence the place of every time in it."""
    stacked = np.concatenate(times)
    order = np.argsort(stacked, kind="stable")
    shortest = min(float(np.median(np.diff(time))) for time in times if len(time) > 1)
    new = np.concatenate(([True], np.diff(stacked[order]) > SAME_TIME * shortest))
    place = np.empty(len(stacked), dtype=int)
    place[order] = np.cumsum(new) - 1
    ends = np.cumsum([len(time) for time in times])[:-1]
    return stacked[order][new], np.split(place, ends)


def _check_overlap(tables: Sequence[Table], times: Sequence[np.ndarray]) -> None:
    for table, time in zip(tables, times, strict=True):
        if len(time) < 2:
            raise InputError("data.path", table.path, "a file of at least 2 samples", f"it has {len(time)}")
    late = max(range(len(times)), key=lambda i: times[i][0])
    early = min(range(len(times)), key=lambda i: times[i][-1])
    if times[late][0] > times[early][-1]:
        extents = (
            f"{tables[i].path.name} from {times[i][0]:.9g} to {times[i][-1]:.9g} s" for i in sorted((early, late))
        )
        hint = "data.time_unit, or clocks that were not set together?"
        raise InputError("data.path", ", ".join(extents), "records whose clocks overlap", hint)
