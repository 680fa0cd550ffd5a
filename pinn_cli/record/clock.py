"""When the samples of files were taken: by a column of times, by a sampling rate, or by a file's own header."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.excel import ExcelFormat
from pinn_cli.record.files.file_format import FIRST_BYTES, ArrayFormat, FileFormat, looks_like_text, read_bytes
from pinn_cli.record.files.hdf5 import Hdf5Format
from pinn_cli.record.files.mat import MatFormat
from pinn_cli.record.files.netcdf import NetcdfFormat
from pinn_cli.record.files.parquet import ParquetFormat
from pinn_cli.record.files.table import SensorHint, Table, check_names, column_of_times, is_called_times, unit_of_times
from pinn_cli.record.files.tdms import TdmsFormat
from pinn_cli.record.files.uff import UffFormat
from pinn_cli.record.files.variables import joined
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import finite_number

log = logging.getLogger(__name__)

FORMATS: tuple[type[FileFormat], ...] = (
    CsvFormat, MatFormat, UffFormat, ParquetFormat, TdmsFormat, Hdf5Format, NetcdfFormat, ExcelFormat,
)  # fmt: skip
# Units of a column of times, and how many of them a second has.
TIME_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1.0 / 60.0, "h": 1.0 / 3600.0, "d": 1.0 / 86400.0}
# s from 1970 to 2100: a clock that counts more counts from 1970 in a smaller unit.
UNTIL_2100 = 4.1e9
# Days from 1970 to 2100 as Excel and MATLAB number them: read so where, as s, a clock of more Hz than this had them.
DAY_NUMBERS, FASTEST_CLOCK = ((25569, 73051), (719529, 767011)), 5e4
# A clock that begins later, s, began at a date such as 1970: no record takes 20 years.
LATEST_BEGIN = 6.3e8
# Stands for the column of times, whatever it is called.
BY_NAME = ""

# Times are printed with few digits: let each be off the regular axis by this part of a step, or by its last digit.
TIME_TOLERANCE = 0.01
LARGEST_TIME_TOLERANCE = 0.25
# One step that is more of a record than this part was never waited for: somebody has set the clock.
MOST_OF_RECORD = 0.9


@dataclass(frozen=True, eq=False)
class Clock:
    """The times of a table's samples.

    Attributes:
        table: Whose samples they are.
        column: Of the times; "": they come from a sampling rate, a header or several files, s, and need no check.
        readings: (N,), increasing, in ``unit``.
        unit: A key of `TIME_UNITS`.
        several: Whether they are the times of several files: each may be even, and all together not.
    """

    table: Table
    column: str
    readings: np.ndarray
    unit: str = "s"
    several: bool = False

    @classmethod
    def by_column(cls, table: Table, column: str, unit: str | None) -> Clock:
        """The times that a column has.

        Where no unit is given it is what the header says, if it is a key of `TIME_UNITS`, else s, or what of ms, us and
        ns makes dates of numbers that are too large for s, or d of numbers of days.

        Raises:
            InputError: A time that is missing, or not later than the one before it.
        """
        readings = table.numbers(column)
        if unit is None:
            unit = table.hints.get(column, SensorHint()).unit or unit_of_times(column)
        if unit not in TIME_UNITS:
            largest = float(np.max(readings, initial=0.0))
            unit = next((name for name in ("s", "ms", "us", "ns") if largest < UNTIL_2100 * TIME_UNITS[name]), "s")
            unit = "d" if _are_days(readings) else unit
        table.refuse_gaps(column, readings)
        back = np.flatnonzero(np.diff(readings) <= 0)
        if len(back):
            row = int(back[0]) + 1
            allowed = f"later than the line before it, {readings[row - 1]:.9g}"
            stands = readings[row] == readings[row - 1]
            hint = "too few digits? Give data.sampling_rate, in Hz, instead" if stands else ""
            raise InputError(table.place(column, row), readings[row], allowed, hint)
        return cls(table, column, readings, unit)

    @property
    def time(self) -> np.ndarray:
        """(N,), s."""
        return self.readings / TIME_UNITS[self.unit]

    @property
    def dates(self) -> bool:
        """Whether the readings count from a date such as 1970, and not from the record's beginning."""
        return len(self.readings) > 0 and bool(self.time[0] > LATEST_BEGIN)

    def regular(self, first: int, last: int) -> tuple[np.ndarray, bool]:
        """Times of rows first..last (``last`` excluded), s, and whether they are even.

        Even ones are put onto the regular axis between their ends, uneven ones are as they are.

        Raises:
            InputError: Uneven times that the file's own header tells: they are no readings of a clock; or a clock that
                jumps, and leaves nearly nothing of the record.
        """
        try:
            return self.uniform(first, last), True
        except InputError:
            if not self.column and not self.several:
                raise
        time = self.readings[first:last]
        steps = np.diff(time)
        row = int(np.argmax(steps)) + 1
        if self.column and steps[row - 1] > MOST_OF_RECORD * steps.sum():
            allowed = f"near the line before it, {time[row - 1]:.9g}"
            hint = "was the clock set there? Cut the record by data.start or data.stop, or make it two (data.records)"
            raise InputError(self.table.place(self.column, first + row), time[row], allowed, hint)
        return self.time[first:last], False

    def step(self, first: int, last: int) -> float:
        """The usual one among rows first..last (``last`` excluded), s."""
        return float(np.median(np.diff(self.time[first:last])))

    def uniform(self, first: int, last: int) -> np.ndarray:
        """Times of rows first..last (``last`` excluded), put onto the regular axis between their ends, s.

        Raises:
            InputError: Times that are off it by more than their printed digits explain; names the line of the jump.
        """
        time = self.readings[first:last]
        regular = np.linspace(time[0], time[-1], len(time))
        step = float(np.median(np.diff(time)))
        tolerance = min(LARGEST_TIME_TOLERANCE * step, max(TIME_TOLERANCE * step, _last_digit(time)))
        if np.max(np.abs(time - regular)) <= tolerance:
            return regular / TIME_UNITS[self.unit]
        deviation = np.abs(np.diff(time) - step)
        jumps = np.flatnonzero(deviation > 2.0 * tolerance)
        row = int(jumps[0] if len(jumps) else np.argmax(deviation)) + 1
        allowed = f"one step of {step:.6g} {self.unit} after the line before it, {time[row - 1]:.9g}"
        hint = "rows are missing, or the file must be resampled to a uniform time axis"
        place = self.table.place(self.column or "its own times", first + row)
        raise InputError(place, time[row], allowed, hint)


def _are_days(readings: np.ndarray) -> bool:
    """Whether readings without a unit are days that Excel or MATLAB has numbered."""
    if len(readings) < 2 or not any(first <= readings[0] <= readings[-1] < end for first, end in DAY_NUMBERS):
        return False
    return bool(np.median(np.diff(readings)) < 1.0 / FASTEST_CLOCK)


def _last_digit(time: np.ndarray) -> float:
    """A unit of the last decimal that the times are printed with; 0 beyond nine decimals."""
    for decimals in range(10):
        if np.allclose(time, np.round(time, decimals), rtol=1e-14, atol=1e-12):
            return float(10.0**-decimals)
    return 0.0


@dataclass(frozen=True)
class MeasuredFiles:
    """Files of one record, and how their samples' times are told.

    Attributes:
        paths: Of one file or more; those of several stand on one clock.
        format, time, sampling_rate, time_unit, missing: See :class:`pinn_cli.record.measured_data.MeasuredData`.

    Raises:
        InputError: Such a mark is none.
    """

    paths: tuple[Path, ...]
    format: FileFormat
    time: str | None = None
    sampling_rate: float | None = None
    time_unit: str | None = None
    missing: Any = None

    def __post_init__(self) -> None:
        if self.missing is not None:
            several = isinstance(self.missing, Sequence) and not isinstance(self.missing, str)
            given = self.missing if several else [self.missing]
            object.__setattr__(self, "missing", [finite_number("data.missing", number) for number in given])

    def read(self, wanted: Mapping[str, str] | None = None) -> Clock:
        """The columns that are asked for, and when they were sampled.

        Args:
            wanted: Setting to the name of the column that it asks for, that of the times left out; None: every column
                that has numbers.

        Raises:
            InputError: A file, column or cell that cannot be used; nothing tells the times; clocks of several files
                that do not overlap, or columns of the same name in two of them.
        """
        if len(self.paths) == 1:
            return self.clock(self.table(self.paths[0], wanted))
        tables = [self.table(path, None) for path in self.paths]
        dates = tables[0].dates(self.column_in(tables[0]) or "")
        clocks = [self.clock(table, dates[0] if dates else None) for table in tables]
        begin = min(clock.time[0] for clock in clocks) if dates or all(clock.dates for clock in clocks) else 0.0
        times = {clock.column for clock in clocks}
        if wanted is not None:
            names = [name for clock in clocks for name in clock.table.columns if name not in times]
            shown, kept = Path(", ".join(path.name for path in self.paths)), set(wanted.values())
            check_names(shown, wanted, names)
            clocks = [
                replace(c, table=replace(c.table, columns={n: v for n, v in c.table.columns.items() if n in kept}))
                for c in clocks
            ]
        table = joined([clock.table for clock in clocks], [clock.time - begin for clock in clocks], sorted(times))
        assert table.time is not None
        return Clock(table, "", table.time, several=True)

    def time_column(self, path: Path) -> str | None:
        """Column of a file's times, or `BY_NAME`; None: the sampling rate is given, or the file's header tells it."""
        if self.time is not None:
            return self.time
        return None if self.sampling_rate is not None or format_of(path, self.format).tells_time else BY_NAME

    def takes_for_times(self, column: str) -> bool:
        """Whether a column is that of the times in one of the files."""
        looked_for = {self.time_column(path) for path in self.paths}
        return column in looked_for or (BY_NAME in looked_for and is_called_times(column))

    def table(self, path: Path, wanted: Mapping[str, str] | None) -> Table:
        """The columns of one of the files; see :meth:`read`."""
        time = self.time_column(path)
        if wanted is not None and time is not None:
            wanted = {"data.time": time, **wanted}
        read = format_of(path, self.format).read(path, wanted)
        table = read.with_gaps(self.missing, self.column_in(read))
        for note in table.notes:
            log.warning(note)
        return table

    def clock(self, table: Table, first_date: str | None = None) -> Clock:
        """When the samples of one of the files were taken; see :meth:`Table.with_dates`.

        Dates of the only file count from the first.

        Raises:
            InputError: Nothing tells it, or a column of times cannot be used.
        """
        column = self.column_in(table)
        if self.sampling_rate is not None:
            return Clock(table, "", np.arange(len(table)) / self.sampling_rate)
        if column is not None:
            check_names(table.path, {"data.time": column}, table.columns, "or give data.sampling_rate, in Hz")
            clock = Clock.by_column(table.with_dates(column, first_date), column, self.time_unit)
        elif table.time is not None:
            clock = Clock(table, "", table.time)
        else:
            hint = f"{table.path.name} does not say when its samples were taken"
            raise InputError("data.sampling_rate", None, "given, in Hz, or data.time, a column of times", hint)
        alone = len(self.paths) == 1 and clock.dates
        return replace(clock, readings=clock.readings - clock.readings[0]) if alone else clock

    def column_in(self, table: Table) -> str | None:
        """Column of the times of a table; None: its header tells them, or nothing does."""
        column = self.time_column(table.path)
        if column != BY_NAME:
            return column
        column = column_of_times(table.columns)
        return None if table.time is not None and column not in table.columns else column

    def unsaid_times(self, table: Table) -> str | None:
        """The first column of one of the files, where it rises and nobody has said what the times are; else None."""
        column = self.time_column(table.path)
        said = self.sampling_rate is not None or table.time is not None or column not in (BY_NAME, None)
        if said or (column == BY_NAME and column_of_times(table.columns) in table.columns):
            return None
        named = column_of_times(table.columns)
        first = named if named in table.columns else next(iter(table.columns), "")
        values = table.with_dates(first).columns.get(first, np.zeros(0))
        return first if len(values) > 1 and bool(np.all(np.diff(values) > 0)) else None


def recognised(path: Path) -> FileFormat:
    """The format of a file, by its suffix and how it begins.

    Raises:
        InputError: It is missing, cannot be read, or is in no format that anybody here reads.
    """
    content, suffix = read_bytes(path, most=FIRST_BYTES), _suffix(path)
    by_name = [kind for kind in FORMATS if suffix in (*kind.suffixes, *kind.other_suffixes)]
    arrays = [kind() for kind in (*by_name, *FORMATS) if issubclass(kind, ArrayFormat)]
    for file_format in arrays:
        foreign = by_name or (isinstance(file_format, MatFormat) and not content.startswith(b"MATLAB"))
        if file_format.begins(content) and (type(file_format) in by_name or not foreign):
            return file_format
    named = next((kind for kind in by_name if suffix in kind.suffixes), None)
    if named or looks_like_text(content):
        return (named or CsvFormat)()
    formats = ", ".join(f"{kind.name} ({', '.join(kind.suffixes)})" for kind in FORMATS)
    raise InputError("data.path", path, f"a file in one of the formats {formats}")


def _suffix(path: Path) -> str:
    return (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower()


def format_of(path: Path, chosen: FileFormat) -> FileFormat:
    """The format chosen by ``data=...``, unless the file's suffix is none of its own and that of another."""
    suffix = _suffix(path)
    if suffix in (*chosen.suffixes, *chosen.other_suffixes):
        return chosen
    return next((other() for other in FORMATS if suffix in other.suffixes), chosen)
