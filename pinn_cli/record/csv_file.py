"""Columns of a CSV file as numbers, and errors that name file, column and line."""

from __future__ import annotations

import csv
import warnings
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

# The header is line 1.
FIRST_LINE = 2

# Times are printed with few digits: let each be off the regular axis by this part of a step, or by its last digit.
TIME_TOLERANCE = 0.01
LARGEST_TIME_TOLERANCE = 0.25


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
        header = self._read(nrows=0).columns
        for setting, column in columns.items():
            if column not in header:
                few = len(header) == 1 and any(mark in header[0] for mark in ";\t")
                hint = "the file must be separated by commas" if few else ""
                allowed = f"a column of {path.name}, which has {', '.join(map(repr, header))}"
                raise InputError(setting, repr(column), allowed, hint)
        # Blank lines are kept, so that rows and lines go together; those at the end are no gap.
        frame = self._read(usecols=sorted(set(columns.values())))
        self._check_cells(len(header))
        filled = np.flatnonzero(frame.notna().any(axis=1))
        self._frame = frame.iloc[: filled[-1] + 1 if len(filled) else 0]

    def _check_cells(self, names: int) -> None:
        """The first row of numbers may end with commas, but not have more cells than the header has names."""
        with self.path.open(newline="", encoding="utf-8-sig") as file:
            rows = filter(None, csv.reader(file, skipinitialspace=True))
            next(rows)
            cells = next(rows, [])
        filled = max((place for place, cell in enumerate(cells, start=1) if cell.strip()), default=0)
        if filled > names:
            hint = "a decimal comma, or a column without a name? Cells belong together by their place"
            place = f"{self.path.name}, first row of numbers"
            raise InputError(place, f"{filled} cells", f"as many as the header has names, {names}", hint)

    def numbers(self, column: str, first: int = 0, last: int | None = None) -> np.ndarray:
        """The column's cells in rows first..last (counted from 0, ``last`` excluded).

        Raises:
            InputError: A cell that is empty or no finite number.
        """
        cells = self._frame[column].iloc[first:last]
        values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            cell = cells.iloc[bad[0]]
            shown = "empty or NaN" if pd.isna(cell) else repr(str(cell))
            hint = "leave gaps out with data.start and data.stop"
            raise InputError(self.place(column, first + int(bad[0])), shown, "a finite number", hint)
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

    def _read(self, **options: object) -> pd.DataFrame:
        options |= {"skip_blank_lines": False, "skipinitialspace": True, "encoding": "utf-8-sig", "low_memory": False}
        # Rows that end with a comma have a cell more than the header; pandas would take their first one for a label.
        options["index_col"] = False
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", pd.errors.ParserWarning)  # of that cell
                frame: pd.DataFrame = pd.read_csv(self.path, **options)  # type: ignore[call-overload]
            return frame
        except FileNotFoundError:
            hint = "a relative path starts where pinn-run was called"
            raise InputError("data.path", self.path, "a file that exists", hint) from None
        except (OSError, UnicodeDecodeError, pd.errors.EmptyDataError, pd.errors.ParserError) as error:
            raise InputError("data.path", self.path, "a readable file of comma-separated values", str(error)) from None


def _last_digit(time: np.ndarray) -> float:
    """A unit of the last decimal that the times are printed with; 0 beyond nine decimals."""
    for decimals in range(10):
        if np.allclose(time, np.round(time, decimals), rtol=1e-14, atol=1e-12):
            return float(10.0**-decimals)
    return 0.0
