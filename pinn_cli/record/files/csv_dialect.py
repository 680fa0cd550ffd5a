"""How the cells of a text file are separated and its decimals written, by its first lines."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import islice

# In the order in which they are tried; the last stands for any number of blanks.
BLANKS = " "
SEPARATORS = ("\t", ";", ",", "|", BLANKS)
# Lines that are looked at.
_LINES = 20

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?$|[+-]?(nan|inf)$|$", re.IGNORECASE)
_POINT = re.compile(r"[+-]?\d*\.\d")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?\s*$")


@dataclass(frozen=True)
class Dialect:
    """How a file of text is written.

    Attributes:
        separator: One of `SEPARATORS`, or another character.
        decimal: The point or the comma.
    """

    separator: str
    decimal: str

    @classmethod
    def of(cls, text: str, separator: str | None, decimal: str | None) -> Dialect:
        """As given, and the rest as the first lines of a text show it.

        Args:
            text: From the line of names on.
            separator: Between cells; None: to be found.
            decimal: Point or comma; None: to be found.
        """
        lines = list(islice((line for line in StringIO(text) if line.strip()), _LINES))
        separator = separator or _separator(lines)
        return cls(separator, decimal or _decimal(rows_of(lines[1:], separator), separator))


def rows_of(lines: Sequence[str], separator: str) -> list[list[str]]:
    """Cells of lines, row by row.

    Raises:
        csv.Error: They are no table.
    """
    if separator == BLANKS:
        return [line.split() for line in lines]
    return [list(map(str.strip, row)) for row in csv.reader(lines, delimiter=separator, skipinitialspace=True)]


def _separator(lines: Sequence[str]) -> str:
    """The first by which every row has the header's number of cells, and half of them are numbers; else a comma."""
    for separator in SEPARATORS:
        try:
            header, *rows = rows_of(lines, separator)
        except (csv.Error, ValueError):
            continue
        count = _filled(header)
        if count > 1 and rows and all(_filled(row) <= count <= max(len(row), 1) for row in rows[1:] or rows):
            cells = [cell for row in rows for cell in row]
            if 2 * sum(_NUMBER.match(cell) is not None for cell in cells) >= len(cells):
                return separator
    return ","


def _decimal(rows: Sequence[Sequence[str]], separator: str) -> str:
    """The comma, where the first rows have decimals with commas and none with points."""
    cells = [cell for row in rows for cell in row]
    commas = separator != "," and any(_COMMA.match(cell) for cell in cells)
    return "," if commas and not any(_POINT.match(cell) for cell in cells) else "."


def _filled(row: Sequence[str]) -> int:
    """Number of cells up to the last one that is filled."""
    return max((place for place, cell in enumerate(row, start=1) if cell), default=0)
