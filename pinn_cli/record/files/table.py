"""Columns of files as numbers, whatever their format, on one clock; and errors that name file, column and line."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.files.dates import first_other, seconds_of
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import LARGEST, SMALLEST, USABLE

if TYPE_CHECKING:
    import pandas as pd

# What an error says of the names of columns at most.
_NAMES, _NAME_LENGTH = 20, 60
# What a column of times should be called, and may be, in large letters or small ones: T is a temperature.
TIMES, _ALSO_TIMES = "t", (
    "time", "zeit", "timestamp", "zeitstempel", "datetime", "date/time", "date time", "date_time", "datum/zeit",
    "datum uhrzeit", "uhrzeit", "elapsed time", "relative time", "time stamp", "x_value", "seconds", "date", "datum",
)  # fmt: skip
# A unit in brackets at the end of a column's name.
IN_BRACKETS = re.compile(r"(?P<name>.*\S)\s*[\[(]\s*(?P<unit>[^\[\]()]+?)\s*[\])]\s*$")
# Times that differ by less than this part of the shortest step are the same.
SAME_TIME = 0.01
# Cells that are no numbers, and how to write them as such.
_WRITTEN_AS = (
    (
        re.compile(r"\d{4}-\d\d|\d\d?[./]\d\d?[./]\d|\d\d?:\d\d"),
        "write times as seconds, such as 0, 0.01, or all as dates: 2026-03-01T12:00:00.25, 1.3.2026 12:00:00.25",
    ),
    (re.compile(r"[+-]?\d+,\d+([eE].*)?$"), "write decimals with a point"),
    (re.compile(r"(true|false|yes|no|on|off)$", re.IGNORECASE), "write 1 and 0 if these are numbers"),
    (re.compile(r"=|[+-]?[A-Za-z]\w*\("), "it looks like a formula, and pinn-run evaluates none: save its value"),
)
# m/s² is m/s^2, and both letters that are written for micro are u.
_PLAIN = str.maketrans({"\N{SUPERSCRIPT TWO}": "2", "\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u"})
_LEFT_OUT = "leave gaps out with data.start and data.stop"


@dataclass(frozen=True)
class SensorHint:
    """What a file's own header says of a column; "" where it says nothing.

    Attributes:
        unit: As the header writes it, such as ``m/s^2`` or ``g``, but for brackets and raised digits.
        quantity: displacement, velocity, acceleration or force.
        place: Of the sensor: a node and a direction such as ``3:+Z``, or another label.
    """

    unit: str = ""
    quantity: str = ""
    place: str = ""

    def __post_init__(self) -> None:
        plain = self.unit.strip().strip("[]()").strip().translate(_PLAIN)
        object.__setattr__(self, "unit", re.sub(r"(?<=[A-Za-z])(?=\d)", "^", plain))


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one length, sample by sample.

    Attributes:
        path: Of the file, for errors.
        columns: Name to numbers (N,), float64, as the file has them, in its own unit; NaN where a cell is empty.
        odd_cells: Name to the cells that are no number: row, counted from 0, to text. They are NaN in `columns`.
        hints: Name to what the header says of the column.
        time: Of the samples, (N,), s, where the header tells it; None: a column has the times, or nothing has.
        first_line: Line of the first row in a text file; None where rows are no lines: an error then counts samples.
        sources: Where columns of several tables are joined, name to the table that one comes from, and the row there of
            each row here, -1 where it has none; (N,).
    """

    path: Path
    columns: Mapping[str, np.ndarray]
    odd_cells: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    hints: Mapping[str, SensorHint] = field(default_factory=dict)
    time: np.ndarray | None = None
    first_line: int | None = None
    sources: Mapping[str, tuple[Table, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of_cells(
        cls, path: Path, cells: Mapping[str, pd.Series], units: Mapping[str, str], decimal: str = ".",
        first_line: int | None = None,
    ) -> Table:  # fmt: skip
        """Of cells that pandas holds, of any type. Dates are s from the first of them, durations s.

        Args:
            path: Of the file, for errors.
            cells: Name to cells (N,).
            units: Name to unit, of columns or others.
            decimal: Of cells that are text, ``.`` or ``,``.
            first_line: See above.
        """
        read = {name: _numbers(column, decimal) for name, column in cells.items()}
        return cls(
            path,
            {name: numbers for name, (numbers, _) in read.items()},
            {name: odd for name, (_, odd) in read.items()},
            {name: SensorHint(unit) for name, unit in units.items() if unit and name in read},
            first_line=first_line,
        )

    def __len__(self) -> int:
        arrays = [*self.columns.values(), *([] if self.time is None else [self.time])]
        return len(arrays[0]) if arrays else 0

    def numbers(self, column: str, first: int = 0, last: int | None = None) -> np.ndarray:
        """The column's cells in rows first..last (counted from 0, ``last`` excluded); NaN where one is empty.

        Raises:
            InputError: A cell that is no finite number, or no quantity by its size.
        """
        values = self.columns[column][first:last]
        odd = sorted(row for row in self.odd_cells.get(column, ()) if first <= row < first + len(values))
        if odd:
            text = self.odd_cells[column][odd[0]].strip()
            hints = (hint for pattern, hint in _WRITTEN_AS if pattern.match(text))
            raise InputError(self.place(column, odd[0]), shortened(text), "a finite number", next(hints, _LEFT_OUT))
        if len(values) == 0 or np.isnan(size := np.abs(values)).all():
            return values
        largest = int(np.nanargmax(size))
        if np.isinf(size[largest]):
            raise InputError(self.place(column, first + largest), repr(str(values[largest])), "a finite number")
        if size[largest] > LARGEST or 0.0 < size[largest] < SMALLEST:
            shown = f"{values[largest]:g}, its largest number"
            hint = "another unit? pinn-run takes SI units"
            raise InputError(self.place(column, first + largest), shown, USABLE, hint)
        return values

    def only(self, names: Collection[str]) -> Table:
        """The same with some of its columns."""
        return replace(self, columns={name: values for name, values in self.columns.items() if name in names})

    def with_dates(self, column: str) -> Table:
        """The same with a column whose every cell is a date or a time of day, in s from the first of them.

        Raises:
            InputError: One among dates is none.
        """
        texts = self.odd_cells.get(column, {})
        if not texts or len(texts) < len(self):
            return self
        since = seconds_of(list(texts.values()))
        if since is None:
            row = first_other(list(texts.values()))
            if row is not None:
                text = shortened(list(texts.values())[row])
                raise InputError(self.place(column, list(texts)[row]), text, "a date as in the lines before", _LEFT_OUT)
            return self
        return replace(self, columns={**self.columns, column: since}, odd_cells={**self.odd_cells, column: {}})

    def refuse_gaps(self, column: str, values: np.ndarray, first: int = 0) -> None:
        """Refuse NaN among the numbers of rows ``first`` and on.

        Raises:
            InputError: At the first of them.
        """
        gaps = np.flatnonzero(np.isnan(values))
        if len(gaps):
            raise InputError(
                self.place(column, first + int(gaps[0])), "empty or NaN", "a finite number", _LEFT_OUT
            )  # fmt: skip

    def place(self, column: str, row: int) -> str:
        """How an error names a cell: by the file, column and line that it comes from."""
        where = f"sample {row + 1}" if self.first_line is None else f"line {row + self.first_line}"
        if column not in self.sources:
            return f"{self.path.name}, column {column!r}, {where}"
        table, rows = self.sources[column]
        if rows[row] >= 0 or self.time is None:
            return table.place(column, int(rows[row]))
        return f"{table.path.name}, column {column!r}, at {self.time[row]:.9g} s"


def bare(column: str) -> str:
    """The name of a column without a unit in brackets at its end."""
    found = IN_BRACKETS.fullmatch(column)
    return found["name"] if found else column.strip()


def is_called_times(column: str) -> bool:
    """Whether a column is called as a column of times is."""
    return _rank(column) is not None


def _rank(column: str) -> int | None:
    """How many better names of times there are than that of a column; None: it is none. Groups stand before it."""
    name = bare(column)
    for last in (name, re.split(r"[/.]", name)[-1].strip()):
        if last == TIMES:
            return 0
        if last.casefold() in _ALSO_TIMES:
            return 1 + _ALSO_TIMES.index(last.casefold())
    return None


def column_of_times(names: Collection[str]) -> str:
    """That which is called as it should be; else the one with the best of the other names, the first of several."""
    ranked = [(rank, name) for name in names if (rank := _rank(name)) is not None]
    return min(ranked, key=lambda one: one[0])[1] if ranked else TIMES


def asked_for(path: Path, wanted: Mapping[str, str], names: Collection[str], otherwise: str = "") -> dict[str, str]:
    """Setting to column, with that of the times by its own name where it is asked for as "".

    Args:
        path: Of the file.
        wanted: Setting to the name of the column that it asks for.
        names: Of the file's columns.
        otherwise: See :func:`check_names`.

    Raises:
        InputError: The file lacks a column.
    """
    asked = {setting: column or column_of_times(names) for setting, column in wanted.items()}
    check_names(path, asked, names, otherwise=otherwise)
    return asked


def check_names(
    path: Path, wanted: Mapping[str, str], names: Collection[str], hint: str = "", otherwise: str = ""
) -> None:
    """Refuse a file that lacks a column.

    Args:
        path: Of the file.
        wanted: Setting to the name of the column that it asks for, e.g. ``{"data.force.1": "fp (N)"}``.
        names: Of the file's columns.
        hint: The likely cause, where it is known.
        otherwise: What it may be where no name is near.

    Raises:
        InputError: Naming the setting, and the columns that there are.
    """
    for setting, column in wanted.items():
        if column not in names:
            likely = hint or suggestion(column, list(names)) or otherwise
            raise InputError(setting, repr(column), f"a column of {path.name}, which has {listed(names)}", likely)


def same_length(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Refuse columns of different lengths.

    Raises:
        InputError: Naming two columns and their lengths.
    """
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        short, long = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        shown = f"{lengths[short]} samples of {short!r}, {lengths[long]} of {long!r}"
        hint = "channels of different rates? Put those of one rate into one file, with their times"
        raise InputError(path.name, shown, "columns of one length", hint)


def listed(names: Iterable[str]) -> str:
    """The first of the names, shortened and in quotes, and how many more there are; ``no columns`` of none."""
    every: Sequence[str] = list(names)
    more = f" and {len(every) - _NAMES} more" if len(every) > _NAMES else ""
    return ", ".join(map(shortened, every[:_NAMES])) + more or "no columns"


def shortened(text: str) -> str:
    """In quotes, and cut after 60 characters."""
    return repr(text if len(text) <= _NAME_LENGTH else f"{text[:_NAME_LENGTH]}...")


def _numbers(cells: pd.Series, decimal: str) -> tuple[np.ndarray, dict[int, str]]:
    """Cells (N,) as numbers and odd cells: see :meth:`Table.of_cells`."""
    import pandas as pd

    kind = cells.dtype.kind
    if kind in "mM":
        since = cells - cells.iloc[0] if kind == "M" else cells
        return since.dt.total_seconds().to_numpy(dtype=np.float64), {}
    words = cells
    if decimal == "," and kind not in "iufb":  # a cell that is no number spoils its column
        words = cells.astype("str").str.replace(".", "x").str.replace(",", ".").where(cells.notna())
    numbers = np.full(len(cells), np.nan)
    if kind != "c":
        numbers = pd.to_numeric(words, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan, copy=True)
    is_odd = ~np.isfinite(numbers) & cells.notna().to_numpy()
    if kind not in "iuf":  # True and False are 1 and 0 to pandas
        is_odd |= np.fromiter((isinstance(cell, bool | np.bool_) for cell in cells), bool, len(cells))
    numbers[is_odd] = np.nan
    return numbers, {int(row): str(cells.iloc[row]) for row in np.flatnonzero(is_odd)}


def joined(tables: Sequence[Table], times: Sequence[np.ndarray], without: Sequence[str] = ()) -> Table:
    """One table over all the times that there are; a column is NaN at times that it has no sample of.

    Args:
        tables: Their columns have different names.
        times: Of each table's samples, (N,), s, increasing, on the same clock.
        without: Columns that are left out: those of the times.

    Returns:
        With ``time``, and ``sources``.

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
    every = np.concatenate(times)
    order = np.argsort(every, kind="stable")
    shortest = min(float(np.median(np.diff(time))) for time in times if len(time) > 1)
    new = np.concatenate(([True], np.diff(every[order]) > SAME_TIME * shortest))
    place = np.empty(len(every), dtype=int)
    place[order] = np.cumsum(new) - 1
    ends = np.cumsum([len(time) for time in times])[:-1]
    return every[order][new], np.split(place, ends)


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
