"""Text with a line of names, and cells that are separated by commas or another character."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.csv_dialect import BLANKS, Dialect, rows_of
from pinn_cli.record.files.on_disk import check_size
from pinn_cli.record.files.table import SensorHint, Table, check_names
from pinn_cli.record.files.text_file import check_encoding, read_text
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number

# A unit in brackets at the end of a name, of those that sensors have: a1 (roof) has none.
_SYMBOL = r"(?:[num\u00b5\u03bckM]?(?:m|s|g|N|V|A|Pa)|cm|in|ft|lbf?|[Gg]al|Hz|rad|deg|min|h)"
_UNIT = re.compile(rf".*[\[(]\s*({_SYMBOL}(?:\s*[/*^\u00b7 ]?\s*(?:{_SYMBOL}|[-\u00b2]?\d|\u00b2))*)\s*[\])]\s*$")


@dataclass(frozen=True)
class CsvFormat(FileFormat):
    """A table as text; what is None is recognised.

    Attributes:
        separator: Between cells, a character; a blank stands for any number of blanks and tabs.
        decimal: ``.`` or ``,``.
        encoding: Of the text, as Python calls it.
        names_line: Line of the columns' names, counted from 1; what stands above is passed over. A line of units may
            follow it.

    Raises:
        InputError: Naming ``data.format.<setting>``.
    """

    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    names_line: int = 1

    name = "csv"
    suffixes = (".csv", ".txt", ".tsv", ".dat", ".asc")

    def __post_init__(self) -> None:
        separator = "\t" if self.separator == "\\t" else self.separator
        if separator is not None and (not isinstance(separator, str) or len(separator) != 1 or separator in '"\r\n'):
            raise InputError("data.format.separator", repr(separator), "null or one character, such as ; or \\t")
        object.__setattr__(self, "separator", separator)
        if self.decimal not in (None, ".", ","):
            raise InputError("data.format.decimal", repr(self.decimal), "null, . or ,")
        if self.decimal is not None and self.decimal == separator:
            raise InputError("data.format.decimal", repr(self.decimal), "another character than data.format.separator")
        check_encoding("data.format.encoding", self.encoding)
        whole_number("data.format.names_line", self.names_line, least=1)

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        return self.table(path, read_text(path, encoding=self.encoding), wanted)

    def table(self, path: Path, text: str, wanted: Mapping[str, str] | None = None) -> Table:
        """The columns of a text.

        Args:
            path: Of its file, for errors.
            text: From the file's first line on.
            wanted: See :meth:`read`.

        Raises:
            InputError: See :meth:`read`.
        """
        text = _below(path, text, self.names_line)
        dialect = _dialect(path, text, self.separator, self.decimal)
        header = list(map(str, _frame(path, text, dialect, nrows=0).columns))
        asked = {f"column {name!r}": name for name in header} if wanted is None else wanted
        check_names(path, asked, header)
        units = _check_first_lines(path, text, dialect, asked)
        # Blank lines are kept, so that rows and lines go together; those at the end are no gap.
        frame = _frame(path, text, dialect, usecols=sorted(set(asked.values())), skiprows=[1] if units else None)
        filled = np.flatnonzero(frame.notna().any(axis=1))
        check_size(path, 8 * frame.size)
        frame = frame.iloc[: filled[-1] + 1 if len(filled) else 0]
        return _table(path, frame, dialect, self.names_line + (2 if units else 1), units)


def _below(path: Path, text: str, names_line: int) -> str:
    """The text from the line of names on."""
    if names_line == 1:
        return text
    lines = text.splitlines(keepends=True)
    if len(lines) < names_line:
        raise InputError("data.format.names_line", names_line, f"a line of {path.name}, which has {len(lines)}")
    return "".join(lines[names_line - 1 :])


def _table(path: Path, frame: pd.DataFrame, dialect: Dialect, first_line: int, units: Mapping[str, str]) -> Table:
    columns, odd = {}, {}
    for name in map(str, frame.columns):
        cells = frame[name]
        values = _numbers(cells, dialect.decimal)
        if cells.dtype == bool or cells.dtype == object:  # True and False are 1 and 0 to pandas
            values = np.where([isinstance(cell, bool) for cell in cells], np.nan, values)
        rows = np.flatnonzero(~np.isfinite(values) & cells.notna().to_numpy())
        columns[name] = np.where(np.isfinite(values), values, np.nan)
        odd[name] = {int(row): str(cells.iloc[row]) for row in rows}
    named = {name: match[1].strip() for name in columns if (match := _UNIT.match(name))}
    hints = {name: SensorHint(unit) for name, unit in {**named, **units}.items() if unit and name in columns}
    return Table(path, columns, odd, hints, first_line=first_line)


def _numbers(cells: pd.Series, decimal: str) -> np.ndarray:
    """Of cells, NaN of those that are empty or no number."""
    if decimal == "," and cells.dtype not in (np.float64, np.int64, bool):  # a cell that is no number spoils its column
        text = cells.astype("str").str.replace(".", "x").str.replace(",", ".")
        cells = text.where(cells.notna())
    return np.asarray(pd.to_numeric(cells, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan))


def _dialect(path: Path, text: str, separator: str | None, decimal: str | None) -> Dialect:
    try:
        return Dialect.of(text, separator, decimal)
    except csv.Error as error:
        raise _not_csv(path, error) from None


def _check_first_lines(path: Path, text: str, dialect: Dialect, wanted: Mapping[str, str]) -> dict[str, str]:
    """A name that is asked for is there once; the first row of numbers has as many cells as there are names.

    It may end with separators.

    Returns:
        Name to unit, where the first line after the names has no number at all.
    """
    lines = list(islice((line for line in StringIO(text, newline="") if line.strip()), 2))
    try:
        header, cells = [*rows_of(lines, dialect.separator), []][:2]
    except csv.Error as error:
        raise _not_csv(path, error) from None
    for setting, column in wanted.items():
        if header.count(column) > 1:
            hint = f"it is there {header.count(column)} times: give each its own name"
            raise InputError(setting, repr(column), f"the name of one column of {path.name}", hint)
    _check_count(path, header, cells)
    return _units(header, cells)


def _units(header: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    words = [cell for cell in cells if cell]
    if len(words) < len(header) / 2 or any(any(mark.isdigit() for mark in word.split("^")[0][:1]) for word in words):
        return {}
    if any(re.match(r"[+-]?\.?\d|nan|inf|true|false", word, re.IGNORECASE) for word in words):
        return {}
    return {name: cell.strip("[]() ") for name, cell in zip(header, cells, strict=False)}


def _check_count(path: Path, header: Sequence[str], cells: Sequence[str]) -> None:
    names = len(header)
    filled = max((place for place, cell in enumerate(cells, start=1) if cell.strip()), default=0)
    if filled > names:
        hint = "a decimal comma, or a column without a name? Cells belong together by their place"
        place = f"{path.name}, first row of numbers"
        raise InputError(place, f"{filled} cells", f"as many as the header has names, {names}", hint)


def _frame(path: Path, text: str, dialect: Dialect, **options: Any) -> pd.DataFrame:
    options |= {"sep": r"\s+" if dialect.separator == BLANKS else dialect.separator, "decimal": dialect.decimal}
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
