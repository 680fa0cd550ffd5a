"""Text with a line of names, and cells that are separated by commas or another character."""

from __future__ import annotations

import codecs
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
from pinn_cli.record.files.on_disk import check_size, read_text
from pinn_cli.record.files.table import Table, asked_for
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number

# A unit in brackets at the end of a name, of those that sensors have: a1 (roof) has none.
_SYMBOL = r"(?:[num\u00b5\u03bckM]?(?:m|s|g|N|V|A|Pa)|cm|in|ft|lbf?|[Gg]al|Hz|rad|deg|min|h)"
_UNIT = re.compile(rf".*[\[(]\s*({_SYMBOL}(?:\s*[/*^\u00b7 ]?\s*(?:{_SYMBOL}|[-\u00b2]?\d|\u00b2))*)\s*[\])]\s*$")
# In the order in which they are tried; the last stands for any number of blanks.
BLANKS = " "
SEPARATORS = ("\t", ";", ",", "|", BLANKS)
# Lines that are looked at to find out which it is.
_LINES = 20
_CELL = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?$|[+-]?(nan|inf)$|$", re.IGNORECASE)
_POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?\s*$")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?\s*$")
# What no unit begins with.
_NUMBER = re.compile(r"[+-]?\.?\d|nan|inf|true|false", re.IGNORECASE)


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
        try:
            codecs.lookup(self.encoding or "utf-8")
        except (LookupError, TypeError):
            allowed = "null or an encoding of text, such as utf-8, cp1252 or utf-16"
            raise InputError("data.format.encoding", self.encoding, allowed) from None
        whole_number("data.format.names_line", self.names_line, least=1)

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        return self.table(path, read_text(path, encoding=self.encoding), wanted)

    def table(self, path: Path, text: str, wanted: Mapping[str, str] | None = None) -> Table:
        """The columns of a text.

        Raises:
            InputError: See :meth:`read`.
        """
        lines = text.splitlines(keepends=True) if self.names_line > 1 else [text]
        if len(lines) < self.names_line:
            allowed = f"a line of {path.name}, which has {len(lines)}"
            raise InputError("data.format.names_line", self.names_line, allowed)
        text = "".join(lines[self.names_line - 1 :])
        try:
            return self._columns(path, text, wanted)
        except (csv.Error, pd.errors.EmptyDataError, pd.errors.ParserError) as error:
            raise InputError("data.path", path, "a readable file of comma-separated values", str(error)) from None

    def _columns(self, path: Path, text: str, wanted: Mapping[str, str] | None) -> Table:
        """The columns of a text that begins with their names."""
        lines = list(islice((line for line in StringIO(text, newline="") if line.strip()), _LINES))
        separator = self.separator or next((one for one in SEPARATORS if _separates(one, lines)), ",")
        decimal = self.decimal or _decimal(rows_of(lines[1:], separator), separator)
        dialect: dict[str, Any] = {"sep": r"\s+" if separator == BLANKS else separator, "decimal": decimal}
        header = list(map(str, _frame(text, dialect, nrows=0).columns))
        asked = asked_for(path, {f"column {name!r}": name for name in header} if wanted is None else wanted, header)
        units = _checked_units(path, rows_of(lines[:2], separator), asked)
        # Blank lines are kept, so that rows and lines go together; those at the end are no gap.
        frame = _frame(text, dialect, usecols=sorted(set(asked.values())), skiprows=[1] if units else None)
        filled = np.flatnonzero(frame.notna().any(axis=1))
        check_size(path, 8 * frame.size)
        frame = frame.iloc[: filled[-1] + 1 if len(filled) else 0]
        cells = {str(name): frame[name] for name in frame.columns}
        in_brackets = {name: match[1].strip() for name in cells if (match := _UNIT.match(name))}
        first_line = self.names_line + (2 if units else 1)
        return Table.of_cells(path, cells, in_brackets | units, decimal, first_line)


def _checked_units(path: Path, rows: Sequence[Sequence[str]], wanted: Mapping[str, str]) -> dict[str, str]:
    """Name to unit, where the first line after the names has no number at all.

    Raises:
        InputError: A name that is asked for is there twice; or the first row of numbers, which may end with separators,
            has more cells than there are names.
    """
    header, cells = [*rows, [], []][:2]
    for setting, column in wanted.items():
        if header.count(column) > 1:
            hint = f"it is there {header.count(column)} times: give each its own name"
            raise InputError(setting, repr(column), f"the name of one column of {path.name}", hint)
    filled = _filled(cells)
    if filled > len(header):
        hint = "a decimal comma, or a column without a name? Cells belong together by their place"
        place = f"{path.name}, first row of numbers"
        raise InputError(place, f"{filled} cells", f"as many as the header has names, {len(header)}", hint)
    words = [cell for cell in cells if cell]
    if len(words) < len(header) / 2 or any(_NUMBER.match(word) or word[0].isdigit() for word in words):
        return {}
    return {name: cell.strip("[]() ") for name, cell in zip(header, cells, strict=False)}


def _frame(text: str, dialect: dict[str, Any], **options: Any) -> pd.DataFrame:
    options |= {"skip_blank_lines": False, "skipinitialspace": True, "low_memory": False}
    # Rows that end with a comma have a cell more than the header; pandas would take their first one for a label.
    options["index_col"] = False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pd.errors.ParserWarning)  # of that cell
        frame: pd.DataFrame = pd.read_csv(StringIO(text), **dialect, **options)
    return frame


def rows_of(lines: Sequence[str], separator: str) -> list[list[str]]:
    """Cells of lines, row by row.

    Raises:
        csv.Error: They are no table.
    """
    if separator == BLANKS:
        return [line.split() for line in lines]
    return [list(map(str.strip, row)) for row in csv.reader(lines, delimiter=separator, skipinitialspace=True)]


def _separates(separator: str, lines: Sequence[str]) -> bool:
    """Whether every row has the header's number of cells by it, and half of them are numbers."""
    try:
        header, *rows = rows_of(lines, separator)
    except (csv.Error, ValueError):
        return False
    count = _filled(header)
    if count < 2 or not rows or any(not _filled(row) <= count <= max(len(row), 1) for row in rows[1:] or rows):
        return False
    cells = [cell for row in rows for cell in row]
    return 2 * sum(_CELL.match(cell) is not None for cell in cells) >= len(cells)


def _filled(row: Sequence[str]) -> int:
    """Number of cells up to the last one that is filled."""
    return max((place for place, cell in enumerate(row, start=1) if cell), default=0)


def _decimal(rows: Sequence[Sequence[str]], separator: str) -> str:
    """The comma, where cells have decimals with commas and none with points."""
    cells = [cell for row in rows for cell in row]
    commas = separator != "," and any(map(_COMMA.match, cells)) and not any(map(_POINT.match, cells))
    return "," if commas else "."
