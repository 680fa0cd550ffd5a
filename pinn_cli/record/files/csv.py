"""Text with a line of names, and cells that are separated by commas."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.table import Table, check_names
from pinn_cli.record.files.text_file import read_text
from pinn_cli.settings.errors import InputError

# The header is line 1.
FIRST_LINE = 2


class CsvFormat(FileFormat):
    """A comma-separated file with a header line."""

    name = "csv"
    suffixes = (".csv", ".txt")

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        text = read_text(path)
        header = list(_frame(path, text, nrows=0).columns)
        wanted = {f"column {name!r}": name for name in header} if wanted is None else wanted
        few = len(header) == 1 and any(mark in header[0] for mark in ";\t")
        check_names(path, wanted, header, "the file must be separated by commas" if few else "")
        # Blank lines are kept, so that rows and lines go together; those at the end are no gap.
        frame = _frame(path, text, usecols=sorted(set(wanted.values())))
        _check_first_lines(path, text, wanted)
        filled = np.flatnonzero(frame.notna().any(axis=1))
        return _table(path, frame.iloc[: filled[-1] + 1 if len(filled) else 0])


def _table(path: Path, frame: pd.DataFrame) -> Table:
    columns, odd = {}, {}
    for name in frame.columns:
        cells = frame[name]
        values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        if cells.dtype == bool or cells.dtype == object:  # True and False are 1 and 0 to pandas
            values = np.where([isinstance(cell, bool) for cell in cells], np.nan, values)
        rows = np.flatnonzero(~np.isfinite(values) & cells.notna().to_numpy())
        columns[str(name)] = np.where(np.isfinite(values), values, np.nan)
        odd[str(name)] = {int(row): str(cells.iloc[row]) for row in rows}
    return Table(path, columns, odd, first_line=FIRST_LINE)


def _check_first_lines(path: Path, text: str, wanted: Mapping[str, str]) -> None:
    """A name that is asked for is there once; the first row of numbers has as many cells as there are names.

    It may end with commas.
    """
    rows = filter(None, csv.reader(StringIO(text, newline=""), skipinitialspace=True))
    try:
        header, cells = next(rows), next(rows, [])
    except csv.Error as error:
        raise _not_csv(path, error) from None
    for setting, column in wanted.items():
        if header.count(column) > 1:
            hint = f"it is there {header.count(column)} times: give each its own name"
            raise InputError(setting, repr(column), f"the name of one column of {path.name}", hint)
    _check_count(path, header, cells)


def _check_count(path: Path, header: Sequence[str], cells: Sequence[str]) -> None:
    names = len(header)
    filled = max((place for place, cell in enumerate(cells, start=1) if cell.strip()), default=0)
    if filled > names:
        hint = "a decimal comma, or a column without a name? Cells belong together by their place"
        place = f"{path.name}, first row of numbers"
        raise InputError(place, f"{filled} cells", f"as many as the header has names, {names}", hint)


def _frame(path: Path, text: str, **options: Any) -> pd.DataFrame:
    options |= {"skip_blank_lines": False, "skipinitialspace": True, "low_memory": False}
    # Rows that end with a comma have a cell more than the header; pandas would take their first one for a label.
    options["index_col"] = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pd.errors.ParserWarning)  # of that cell
            frame: pd.DataFrame = pd.read_csv(StringIO(text), **options)
        return frame
    except (pd.errors.EmptyDataError, pd.errors.ParserError) as error:
        raise _not_csv(path, error) from None


def _not_csv(path: Path, error: Exception) -> InputError:
    return InputError("data.path", path, "a readable file of comma-separated values", str(error))
