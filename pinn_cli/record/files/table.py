"""Columns of files as numbers, whatever their format, dates as seconds; and errors that name file, column and line.

Dates and times of day are read as ISO 8601 has them, and as people and loggers write them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import LARGEST, SMALLEST, USABLE

# What an error says of the names of columns at most.
_NAMES_TOLD, _NAME_LENGTH = 20, 60
# What a column of times should be called, and may be, in large letters or small ones: T is a temperature.
TIME_COLUMN, _ALSO_TIMES = "t", (
    "time", "zeit", "timestamp", "zeitstempel", "datetime", "date/time", "date time", "date_time", "datum/zeit",
    "datum uhrzeit", "uhrzeit", "elapsed time", "relative time", "time stamp", "x_value", "seconds", "date", "datum",
    "temps", "tiempo", "tempo", "tijd", "tid", "\u6642\u9593", "\u65f6\u95f4",
)  # fmt: skip
# A unit in brackets at the end of a column's name.
IN_BRACKETS = re.compile(r"(?P<name>.*\S)\s*[\[(]\s*(?P<unit>(?!\d+\s*[\])])[^\[\]()]+?)\s*[\])]\s*$")
# A unit of times behind a name without brackets: time_ms, Zeit / s.
_UNIT_BEHIND = re.compile(r"(?P<name>.*\w)\s*[\s_,/]\s*(?P<unit>s|ms|us|ns|min|h)\s*$", re.IGNORECASE)
# What tells how often was sampled: in Hz, or the step in s; and units of both, as factors to these.
_OFTEN = r"(?:sampl\w*?|scan|abtast|mess)[\W_]*"
_TELLS_RATE = re.compile(rf"(?:{_OFTEN})?rate|{_OFTEN}freq\w*|f_?s(?:amp)?", re.IGNORECASE)
_TELLS_STEP = re.compile(
    rf"dt|ts|delta[\W_]*[tx]|(?:time[\W_]*|{_OFTEN})(?:interval\w*|step|period|schritt)", re.IGNORECASE
)
_OF_RATE, _OF_STEP = {"khz": 1e3, "mhz": 1e6}, {"ms": 1e-3, "msec": 1e-3, "us": 1e-6, "ns": 1e-9}
# Cells that stand for no number, and numbers whose digits are grouped by threes, by the sign of their decimals: such as
# 1,234.5 or 1,234,567, one of which a column must have, since 9,807 alone may be meant as 9.807; or what has no sign
# between its digits is whole and too small for one.
_NO_NUMBER = r"(?i:\s*(?:[-\u2013*_.?]+|nan|#[a-z/0]+[!?]?)\s*)"
_GROUPED = {
    decimal: rf"\s*[+-]?[1-9]\d{{0,2}}(?:[{sign}' \u00a0\u202f]\d{{3}})+(?:[{decimal}]\d*)?\s*"
    for decimal, sign in ((".", ","), (",", "."))
}
_SURELY_GROUPED, _TOO_SMALL = r"\d[' \u00a0\u202f]\d|[.,].*[.,]", r"\s*[+-]?\d{1,3}\s*"
# How loggers write that a value is missing: -9999, 99999, -999.25, 9999.9; sizes, as seven digits tell them.
_OF_NINES = np.array([
    999, 999.25, 999.9, 999.99, 999.999, 999.9999, 9999, 9999.25, 9999.9, 9999.99, 9999.999, 99999, 99999.25, 99999.9,
    99999.99, 999999, 999999.9, 9999999,
])  # fmt: skip
_SEVENTH_DIGIT = 5e-8
# A number that comes so many times as often as any other marks something: levels of a converter are met by turns.
COMES_AGAIN = 8
# m/s² is m/s^2, and both letters that are written for micro are u.
_PLAIN_LETTERS = str.maketrans({"\N{SUPERSCRIPT TWO}": "2", "\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u"})
_LEFT_OUT = "leave gaps out with data.start and data.stop"
_TO_WRITE = "decimals take a point, times are seconds or dates, no formula is evaluated; take notes and comments out"
# Dates and times of day. A month in letters, 12-Mar-2026, is read as its number.
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_MONTH = re.compile(rf"(?<=\d)[-./ ]+({'|'.join(_MONTHS)})[a-z]*[-./ ]+(?=\d)", re.IGNORECASE)
_DAY = r"(?P<a>\d{1,4})[-./](?P<b>\d{1,2})[-./](?P<c>\d{1,4})"
_CLOCK = r"(?P<hours>\d{1,3}):(?P<minutes>\d{2})(?::(?P<seconds>\d{2}(?:[.,]\d*)?))?"
_ZONE = r"(?P<zone>Z|[A-Z]{2,5}|(?:UTC|GMT)?\s*(?P<sign>[+-])(?P<zone_hours>\d{1,2}):?(?P<zone_minutes>\d{2})?)"
_WRITTEN = rf"^\s*(?:{_DAY}[,T]?\s*)?(?:{_CLOCK})?\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*{_ZONE}?\s*$"
# Which of the three numbers is the year, the month and the day, in the order in which they are tried.
_ORDERS = ((2, 1, 0), (2, 0, 1), (0, 1, 2))
_DAY_S = 86400.0


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
        plain = self.unit.strip().strip("[]()").strip().translate(_PLAIN_LETTERS)
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
        notes: What the reader has decided that may be wrong, sentences.
        sources: Where columns of several tables are joined, name to the table that one comes from, and the row there of
            each row here, -1 where it has none; (N,).
    """

    path: Path
    columns: Mapping[str, np.ndarray]
    odd_cells: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    hints: Mapping[str, SensorHint] = field(default_factory=dict)
    time: np.ndarray | None = None
    first_line: int | None = None
    notes: Sequence[str] = ()
    sources: Mapping[str, tuple[Table, np.ndarray]] = field(default_factory=dict)

    @classmethod
    def of_cells(
        cls, path: Path, cells: Mapping[str, pd.Series], units: Mapping[str, str], decimal: str = ".",
        first_line: int | None = None,
    ) -> Table:  # fmt: skip
        """Of cells (N,) of any type by name, as pandas holds them, and units by name, of these columns or others.

        Dates are s from the first of them, durations s; ``decimal``, of cells that are text, is ``.`` or ``,``.
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
            text = shortened(self.odd_cells[column][odd[0]].strip())
            raise InputError(self.place(column, odd[0]), text, "a finite number", f"{_TO_WRITE}; {_LEFT_OUT}")
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

    def with_gaps(self, marks: Sequence[float] | None, times: str | None) -> Table:
        """The same with gaps where one of some marks stands for a missing value, but for the column of the times.

        None marks -9999 and the like, where they lie far outside of all others, which a note tells.
        """
        columns, notes = dict(self.columns), list(self.notes)
        for name, values in ((name, values) for name, values in self.columns.items() if name != times):
            is_mark = _missing(values) if marks is None else np.isclose(values[:, None], marks, rtol=1e-6).any(axis=1)
            if not is_mark.any():
                continue
            columns[name] = np.where(is_mark, np.nan, values)
            if marks is None:
                shown = " and ".join(f"{mark:.7g}" for mark in np.unique(values[is_mark]))
                told = f"{is_mark.sum()} samples are {shown}, far from all others, and are taken for missing"
                where = f"{self.path.name}, column {shortened(name)}"
                notes.append(f"{where}: {told}; data.missing=[] takes them for numbers")
        return replace(self, columns=columns, notes=notes)

    def dates(self, column: str) -> list[str]:
        """The cells of a column none of which is a number: dates, if anything."""
        texts = self.odd_cells.get(column, {})
        return list(texts.values()) if len(texts) == len(self) else []

    def with_dates(self, column: str, first: str | None = None) -> Table:
        """The same with a column whose every cell is a date or a time of day, in s from the first one.

        They may count from another ``first`` date, as another file writes it. One that is none among them is refused.
        """
        texts = self.odd_cells.get(column, {})
        dates = self.dates(column)
        if not dates:
            return self
        since = seconds_of([first or dates[0], *dates])
        if since is None:
            row = first_other(dates)
            if row is not None:
                text = shortened(dates[row])
                raise InputError(self.place(column, list(texts)[row]), text, "a date as in the lines before", _LEFT_OUT)
            return self
        return replace(self, columns={**self.columns, column: since[1:]}, odd_cells={**self.odd_cells, column: {}})

    def refuse_gaps(self, column: str, values: np.ndarray) -> None:
        """Refuse NaN among all numbers (N,) of a column, at the first of them."""
        gaps = np.flatnonzero(np.isnan(values))
        if len(gaps):
            raise InputError(self.place(column, int(gaps[0])), "empty or NaN", "a finite number", _LEFT_OUT)

    def place(self, column: str, row: int) -> str:
        """How an error names a cell: by the file, column and line that it comes from."""
        where = f"sample {row + 1}" if self.first_line is None else f"line {row + self.first_line}"
        if column not in self.sources:
            return f"{self.path.name}, column {column!r}, {where}"
        table, rows = self.sources[column]
        if rows[row] >= 0 or self.time is None:
            return table.place(column, int(rows[row]))
        return f"{table.path.name}, column {column!r}, at {self.time[row]:.9g} s"


def mark(values: np.ndarray) -> float | None:
    """Of numbers (N,) one that several are, and that is no measurement by its looks; None: there is none.

    It is farther from all others than these are apart, or it comes again and again where no other number does.
    """
    there = values[np.isfinite(values)]
    for end in (there.min(initial=np.inf), there.max(initial=-np.inf)):
        others = there[there != end]
        if len(there) - len(others) > 1 and _far_off(np.array([end]), others).all():
            return float(end)
    comes = there[np.diff(there, prepend=np.nan) != 0.0]  # what rests at a number comes to it once
    levels, counts = np.unique(comes, return_counts=True)
    most = int(np.argmax(np.append(counts, 0)))
    if 0 < most < len(levels) - 1 and counts[most] >= COMES_AGAIN * np.partition(counts, -2)[-2]:
        return float(levels[most])  # at its ends a sensor is clipped
    return None


def _missing(values: np.ndarray) -> np.ndarray:
    """(N,), which numbers mark missing values by nines."""
    sizes = np.abs(values)
    place = np.searchsorted(_OF_NINES, sizes * (1.0 - _SEVENTH_DIGIT)).clip(max=len(_OF_NINES) - 1)
    nines = np.unique(values[np.abs(sizes - _OF_NINES[place]) <= _SEVENTH_DIGIT * _OF_NINES[place]])
    if not len(nines):
        return np.zeros(len(values), dtype=bool)
    others = values[np.isfinite(values) & ~np.isin(values, nines)]
    return np.isin(values, nines[_far_off(nines, others)])


def _far_off(marks: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(J,), which marks are farther from numbers (N,), which vary, than these are apart."""
    if len(others) == 0 or np.ptp(others) == 0.0:
        return np.zeros(len(marks), dtype=bool)
    return np.asarray(np.maximum(others.min() - marks, marks - others.max()) > np.ptp(others))


def bare(column: str) -> str:
    """The name of a column without a unit in brackets at its end."""
    match = IN_BRACKETS.fullmatch(column)
    return match["name"] if match else column.strip()


def is_called_times(column: str) -> bool:
    """Whether a column is called as a column of times is."""
    return _rank(column) is not None


def unit_of_times(column: str) -> str:
    """The unit behind the name of a column of times; "" where there is none."""
    match = _UNIT_BEHIND.fullmatch(column.translate(_PLAIN_LETTERS))
    return match["unit"].lower() if match else ""


def _rank(column: str) -> int | None:
    """How many better names of times there are than that of a column; None: it is none. Groups stand before it."""
    name = bare(column).lstrip("#% ")  # as of a comment
    match = _UNIT_BEHIND.fullmatch(name.translate(_PLAIN_LETTERS))
    name = match["name"] if match else name
    for last in (name, re.split(r"[/.]", name)[-1].strip()):
        if last == TIME_COLUMN:
            return 0
        plain = re.split(r"\s+\d", last.casefold())[0]  # catman's are Time  1 - default sample rate
        if plain in _ALSO_TIMES:
            return 1 + _ALSO_TIMES.index(plain)
    return None


def rate_of(name: str, value: float, unit: str = "") -> float | None:
    """Hz, where a number by its name (``fs``, ``Sampling rate``, ``dt``) says how often was sampled; else None.

    A unit that is not known is Hz or s.
    """
    rate, step = (kind.fullmatch(name.strip()) for kind in (_TELLS_RATE, _TELLS_STEP))
    if (rate is None and step is None) or not (math.isfinite(value) and value > 0.0):
        return None
    return value * _OF_RATE.get(unit.lower(), 1.0) if rate else 1.0 / (value * _OF_STEP.get(unit.lower(), 1.0))


def column_of_times(names: Collection[str]) -> str:
    """That which is called as it should be; else the one with the best of the other names, the first of several."""
    ranked = [(rank, name) for name in names if (rank := _rank(name)) is not None]
    return min(ranked, key=lambda pair: pair[0])[1] if ranked else TIME_COLUMN


def asked_for(path: Path, wanted: Mapping[str, str], names: Collection[str], otherwise: str = "") -> dict[str, str]:
    """Setting to column, that of the times by its own name where it is asked for as ""; see :func:`check_names`."""
    asked = {setting: column or column_of_times(names) for setting, column in wanted.items()}
    check_names(path, asked, names, otherwise=otherwise)
    return asked


def check_names(
    path: Path, wanted: Mapping[str, str], names: Collection[str], hint: str = "", otherwise: str = ""
) -> None:
    """Refuse a file that lacks a column of those that are asked for, such as ``{"data.force.1": "fp (N)"}``.

    Raises:
        InputError: Naming the setting, the columns that there are, and the likely cause: ``hint``, or a name that is
            near, or ``otherwise``.
    """
    for setting, column in wanted.items():
        if column not in names:
            likely = hint or suggestion(column, list(names)) or otherwise
            raise InputError(setting, repr(column), f"a column of {path.name}, which has {listed(names)}", likely)


def listed(names: Iterable[str]) -> str:
    """The first of the names, shortened and in quotes, and how many more there are; ``no columns`` of none."""
    columns: Sequence[str] = list(names)
    more = f" and {len(columns) - _NAMES_TOLD} more" if len(columns) > _NAMES_TOLD else ""
    return ", ".join(map(shortened, columns[:_NAMES_TOLD])) + more or "no columns"


def shortened(text: str) -> str:
    """In quotes, and cut after 60 characters."""
    return repr(text if len(text) <= _NAME_LENGTH else f"{text[:_NAME_LENGTH]}...")


def _numbers(cells: pd.Series, decimal: str) -> tuple[np.ndarray, dict[int, str]]:
    """Cells (N,) as numbers and odd cells: see :meth:`Table.of_cells`."""
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
    texts = pd.Series(cells.to_numpy()[is_odd], np.flatnonzero(is_odd)).astype("str")
    grouped = texts[texts.str.fullmatch(_GROUPED[decimal])]
    others = numbers[np.isfinite(numbers)]
    small = decimal == "." and len(others) > 0 and bool(np.all((others % 1.0 == 0.0) & (np.abs(others) < 1000.0)))
    if small or grouped.str.contains(_SURELY_GROUPED).any():
        plain = grouped.str.replace(rf"[^\d{decimal}+-]", "", regex=True).str.replace(",", ".")
        numbers[grouped.index], is_odd[grouped.index] = plain.astype(float), False
    is_odd[texts.index[texts.str.fullmatch(_NO_NUMBER)]] = False
    return numbers, {int(row): str(cells.iloc[row]) for row in np.flatnonzero(is_odd)}


def may_group(text: str) -> bool:
    """Whether the comma of a number may stand between groups of digits: in 9,807, but not in 0,807 or 9,81."""
    return re.fullmatch(_GROUPED["."], text) is not None


def commas_group(texts: Sequence[str]) -> bool:
    """Whether commas group the digits of a column: all may, and what has none is whole and below 1000."""
    with_comma = [text for text in texts if "," in text]
    others = [text for text in texts if "," not in text]
    whole = all(re.fullmatch(_TOO_SMALL, text) for text in others)
    return bool(with_comma and others) and whole and all(map(may_group, with_comma))


def seconds_of(texts: Sequence[str]) -> np.ndarray | None:
    """Seconds (N,) from the first of some dates or times of day; None: one of them is none.

    Of numbers such as 3/4/2026 the one is the day by which the record takes least time. Times of day without a date go
    on after midnight.
    """
    dates = pd.to_datetime(pd.Series(texts), format="ISO8601", errors="coerce", utc=True)
    if not dates.isna().any():
        return np.asarray((dates - dates.iloc[0]).dt.total_seconds(), dtype=np.float64)
    parts = _parts(texts)
    dated, named = parts["a"].notna(), parts["sign"].isna()
    if not (dated | parts["hours"].notna()).all() or dated.any() != dated.all():
        return None
    if named.any() and len(parts["zone"].unique()) > 1:  # names of zones, which change
        return None
    clock = _of_the_day(parts)
    if not dated.all():
        turns = np.concatenate(([0], np.cumsum(np.diff(clock) < -0.5 * _DAY_S)))
        return np.asarray(clock + _DAY_S * turns - clock[0])
    days = _days(parts[["a", "b", "c"]].astype(int).to_numpy())
    return None if days is None else np.asarray(clock - clock[0] + _DAY_S * (days - days[0]))


def first_other(texts: Sequence[str]) -> int | None:
    """Place of the first text that is no date or time of day, where the first one of all is; else None."""
    return int(_parts(texts).isna().all(axis=1).argmax()) or None


def _parts(texts: Sequence[str]) -> pd.DataFrame:
    """The parts of dates and times of day, texts; a row without any of what is none."""
    with_numbers = [_MONTH.sub(lambda month: f"-{1 + _MONTHS.index(month[1].lower())}-", text) for text in texts]
    return pd.Series(with_numbers, dtype=str).str.extract(_WRITTEN)


def _of_the_day(parts: pd.DataFrame) -> np.ndarray:
    """(N,), seconds since midnight, of UTC where the zone is a number."""
    numbers = parts[["hours", "minutes", "zone_hours", "zone_minutes"]].fillna("0").astype(int)
    of_twelve = numbers["hours"] % 12 + 12 * parts["half"].str[0].isin(["P", "p"])
    hour = numbers["hours"].where(parts["half"].isna(), of_twelve)
    seconds = parts["seconds"].fillna("0").str.replace(",", ".").astype(float)
    shift = (3600 * numbers["zone_hours"] + 60 * numbers["zone_minutes"]) * np.where(parts["sign"] == "-", -1, 1)
    return np.asarray(3600.0 * hour + 60.0 * numbers["minutes"] + seconds - shift, dtype=np.float64)


def _days(numbers: np.ndarray) -> np.ndarray | None:
    """Days (N,) since the first, of three numbers each; None: in no order of day, month and year all are dates."""
    different, place = np.unique(numbers, axis=0, return_inverse=True)
    tried = []
    for order in _ORDERS:
        year, month, day = different[:, order].T
        frame = pd.DataFrame({"year": np.where(year < 100, year + 2000, year), "month": month, "day": day})
        dates = pd.to_datetime(frame, errors="coerce")
        if not dates.isna().any():
            tried.append((dates - dates.min()).dt.days.to_numpy(dtype=np.float64))
    return min(tried, key=np.max)[place.reshape(-1)] if tried else None
