"""Columns of a CSV file as numbers, and errors that name file, column and line."""

from __future__ import annotations

import csv
import re
import warnings
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.record.text_file import read_text
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import LARGEST, SMALLEST, USABLE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

# The header is line 1.
FIRST_LINE = 2

# Times are printed with few digits: let each be off the regular axis by this part of a step, or by its last digit.
TIME_TOLERANCE = 0.01
LARGEST_TIME_TOLERANCE = 0.25

# What an error says of a header at most.
_NAMES, _NAME_LENGTH = 20, 60
# Cells that are no numbers, and how to write them as such.
_WRITTEN_AS = (
    (re.compile(r"\d{4}-\d\d|\d\d?[./]\d\d?[./]\d|\d\d?:\d\d"), "write times as seconds, such as 0, 0.01, 0.02"),
    (re.compile(r"[+-]?\d+,\d+([eE].*)?$"), "write decimals with a point"),
    (re.compile(r"(true|false|yes|no|on|off)$", re.IGNORECASE), "write 1 and 0 if these are numbers"),
)


class CsvFile:
    """A comma-separated file with a header line.

    Args:
        path: Of the file.
        columns: Setting to the name of the column that it asks for, e.g. ``{"data.force.1": "fp (N)"}``.

    Raises:
        InputError: The file is missing or is no CSV, or lacks a column.
    """

    def __init__(self, path: Path, columns: Mapping[str, str]) -> None:
        self.path = path
        text = read_text(path)
        header = self._read(text, nrows=0).columns
        for setting, column in columns.items():
            if column not in header:
                few = len(header) == 1 and any(mark in header[0] for mark in ";\t")
                hint = "the file must be separated by commas" if few else ""
                raise InputError(
                    setting, repr(column), f"a column of {path.name}, which has {_listed(list(header))}", hint
                )
        # Blank lines are kept, so that rows and lines go together; those at the end are no gap.
        frame = self._read(text, usecols=sorted(set(columns.values())))
        self._check_first_lines(text, columns)
        filled = np.flatnonzero(frame.notna().any(axis=1))
        self._frame = frame.iloc[: filled[-1] + 1 if len(filled) else 0]

    def _check_first_lines(self, text: str, columns: Mapping[str, str]) -> None:
        """A name that is asked for is there once; the first row of numbers has as many cells as there are names.

        It may end with commas.
        """
        rows = filter(None, csv.reader(StringIO(text, newline=""), skipinitialspace=True))
        try:
            header, cells = next(rows), next(rows, [])
        except csv.Error as error:
            raise self._not_csv(error) from None
        for setting, column in columns.items():
            if header.count(column) > 1:
                hint = f"it is there {header.count(column)} times: give each its own name"
                raise InputError(setting, repr(column), f"the name of one column of {self.path.name}", hint)
        names = len(header)
        filled = max((place for place, cell in enumerate(cells, start=1) if cell.strip()), default=0)
        if filled > names:
            hint = "a decimal comma, or a column without a name? Cells belong together by their place"
            place = f"{self.path.name}, first row of numbers"
            raise InputError(place, f"{filled} cells", f"as many as the header has names, {names}", hint)

    def numbers(self, column: str, first: int = 0, last: int | None = None) -> np.ndarray:
        """The column's cells in rows first..last (counted from 0, ``last`` excluded).

        Raises:
            InputError: A cell that is empty or no finite number, or is no quantity in SI units by its size.
        """
        cells = self._frame[column].iloc[first:last]
        values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        if cells.dtype == bool or cells.dtype == object:  # True and False are 1 and 0 to pandas
            values = np.where([isinstance(cell, bool) for cell in cells], np.nan, values)
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            shown, hint = _shown(cells.iloc[bad[0]])
            raise InputError(self.place(column, first + int(bad[0])), shown, "a finite number", hint)
        size = np.abs(values)
        largest = int(np.argmax(size)) if len(size) else 0
        if len(size) and (size[largest] > LARGEST or 0.0 < size[largest] < SMALLEST):
            shown = f"{values[largest]:g}, its largest number"
            hint = "another unit? pinn-run takes SI units"
            raise InputError(self.place(column, first + largest), shown, USABLE, hint)
        return values

    def place(self, column: str, row: int) -> str:
        """How an error names a cell."""
        return f"{self.path.name}, column {column!r}, line {row + FIRST_LINE}"

    def increasing_times(self, column: str) -> np.ndarray:
        """All times of the file, s.

        Raises:
            InputError: A time that is not later than the one before it.
        """
        time = self.numbers(column)
        back = np.flatnonzero(np.diff(time) <= 0)
        if len(back):
            row = int(back[0]) + 1
            raise InputError(self.place(column, row), time[row], f"later than the line before it, {time[row - 1]:.9g}")
        return time

    def uniform_times(self, column: str, time: np.ndarray, first: int) -> np.ndarray:
        """Increasing times, rows ``first`` and on, put onto the regular axis between their ends.

        Raises:
            InputError: Times that are off it by more than their printed digits explain; names the line of the jump.
        """
        regular = np.linspace(time[0], time[-1], len(time))
        step = float(np.median(np.diff(time)))
        tolerance = min(LARGEST_TIME_TOLERANCE * step, max(TIME_TOLERANCE * step, _last_digit(time)))
        if np.max(np.abs(time - regular)) <= tolerance:
            return regular
        deviation = np.abs(np.diff(time) - step)
        jumps = np.flatnonzero(deviation > 2.0 * tolerance)
        row = int(jumps[0] if len(jumps) else np.argmax(deviation)) + 1
        allowed = f"one step of {step:.6g} s after the line before it, {time[row - 1]:.9g}"
        hint = "rows are missing, or the file must be resampled to a uniform time axis"
        raise InputError(self.place(column, first + row), time[row], allowed, hint)

    def _read(self, text: str, **options: object) -> pd.DataFrame:
        options |= {"skip_blank_lines": False, "skipinitialspace": True, "low_memory": False}
        # Rows that end with a comma have a cell more than the header; pandas would take their first one for a label.
        options["index_col"] = False
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", pd.errors.ParserWarning)  # of that cell
                frame: pd.DataFrame = pd.read_csv(StringIO(text), **options)  # type: ignore[call-overload]
            return frame
        except (pd.errors.EmptyDataError, pd.errors.ParserError) as error:
            raise self._not_csv(error) from None

    def _not_csv(self, error: Exception) -> InputError:
        return InputError("data.path", self.path, "a readable file of comma-separated values", str(error))


def _shown(cell: Any) -> tuple[str, str]:
    """A cell that is no number as an error shows it, and how it may be mended."""
    if pd.isna(cell):
        return "empty or NaN", "leave gaps out with data.start and data.stop"
    text = str(cell).strip()
    hints = (hint for pattern, hint in _WRITTEN_AS if pattern.match(text))
    return _shortened(text), next(hints, "leave gaps out with data.start and data.stop")


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMES} more" if len(names) > _NAMES else ""
    return ", ".join(map(_shortened, names[:_NAMES])) + more


def _shortened(text: str) -> str:
    return repr(text if len(text) <= _NAME_LENGTH else f"{text[:_NAME_LENGTH]}...")


def _last_digit(time: np.ndarray) -> float:
    """A unit of the last decimal that the times are printed with; 0 beyond nine decimals."""
    for decimals in range(10):
        if np.allclose(time, np.round(time, decimals), rtol=1e-14, atol=1e-12):
            return float(10.0**-decimals)
    return 0.0
