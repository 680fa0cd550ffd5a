"""Text with a line of names, and cells that are separated by commas or another character."""

from __future__ import annotations

import codecs
import csv
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from itertools import islice, zip_longest
from pathlib import Path

import numpy as np
import pandas as pd

from pinn_cli.record.files.file_format import FileFormat, check_size, read_text
from pinn_cli.record.files.table import IN_BRACKETS, Table, asked_for, commas_group, is_called_times, may_group, rate_of
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number

# A unit, of those that sensors have; at the end of a name, in brackets, behind a stroke or a comma: a1 (roof) has none.
_SYMBOL = r"(?:[num\u00b5\u03bckM]?(?:m|s|g|N|V|A|Pa)|cm|in|ft|lbf?|[Gg]al|Hz|rad|deg|min|h|sec)"
_SYMBOLS = rf"{_SYMBOL}(?:\s*[/*^\u00b7 ]?\s*(?:{_SYMBOL}|[-\u00b2]?\d|\u00b2))*"
_UNIT = re.compile(rf".*(?:[\[(]\s*|\s/\s*|,\s*)({_SYMBOLS})\s*[\])]?\s*$")
_ONLY_UNIT = re.compile(rf"[\[(]?\s*({_SYMBOLS})\s*[\])]?$")
_UNITS_FOLLOW = re.compile(r"(?:^|_|\b)(?:units?|einheit(?:en)?)(?:_|\b)", re.IGNORECASE)
# In the order in which they are tried; the last stands for any number of blanks.
BLANKS = " "
SEPARATORS = ("\t", ";", ",", "|", BLANKS)
# Lines among which the names are looked for, and rows of numbers below them that are looked at.
_SOUGHT, _LINES = 200, 20
# Rows that may stand over each other: two of names, one of units, and one that says how values were made.
_MOST_ROWS = 4
_CELL = re.compile(
    r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}([.,' ]\d{3})+[.,]\d*)([eEdD][+-]?\d+)?$|[+-]?(nan|inf)$|$", re.IGNORECASE
)
_DATE = re.compile(r"\d{1,4}[-./]\d\d?[-./]\d{1,4}|\d\d?:\d\d")
_POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?\s*$")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?\s*$")
_NAMES_LINE = "lines above the names? Name theirs in data.format.names_line"


@dataclass(frozen=True)
class CsvFormat(FileFormat):
    """A table as text; what is None is recognised.

    Attributes:
        separator: Between cells, a character; a blank stands for any number of blanks and tabs.
        decimal: ``.`` or ``,``.
        encoding: Of the text, as Python calls it.
        names_line: Line of the columns' names, counted from 1; what stands above is passed over. A line of units may
            follow it, or a second line of names.

    Raises:
        InputError: Naming ``data.format.<setting>``.
    """

    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    names_line: int | None = None

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
        if self.names_line is not None:
            whole_number("data.format.names_line", self.names_line, least=1)

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        return self.table(path, read_text(path, encoding=self.encoding), wanted)

    def table(self, path: Path, text: str, wanted: Mapping[str, str] | None = None) -> Table:
        """The columns of a text; see :meth:`FileFormat.read`."""
        lines = list(islice(StringIO(text, newline=""), max(self.names_line or 0, 1) + _SOUGHT))
        if len(lines) < (self.names_line or 0):
            allowed = f"a line of {path.name}, which has {len(lines)}"
            raise InputError("data.format.names_line", self.names_line, allowed)
        try:
            return self._columns(path, text, lines, wanted)
        except (csv.Error, pd.errors.EmptyDataError, pd.errors.ParserError) as error:
            reason = f"{str(error).strip()}; {_NAMES_LINE}"
            raise InputError("data.path", path, "a readable file of comma-separated values", reason) from None

    def _columns(self, path: Path, text: str, lines: Sequence[str], wanted: Mapping[str, str] | None) -> Table:
        """The columns of a text, from all of it and from its first lines, down to the names and beyond."""
        heading = self._heading(lines)
        header, separator = heading.header, heading.separator
        decimal = self.decimal or _decimal(heading.numbers, separator)
        times = [name for name in header if is_called_times(name)]
        empty = [name for name in times if not any(row[header.index(name) :][:1] > [""] for row in heading.numbers)]
        rate = rate_above(lines[: heading.line], decimal) if times == empty else None
        heading.check_names(path)
        if wanted is None:
            wanted = {f"column {name!r}": name for name in header}
        elif rate is not None:
            wanted = {setting: column for setting, column in wanted.items() if column}
        asked = asked_for(path, wanted, header, _NAMES_LINE)
        heading.check_columns(path, asked)
        below = text[sum(map(len, lines[: heading.first_line])) :]
        cells = _cells(below, heading, decimal, [name for name in header if name in asked.values()])
        check_size(path, 8 * sum(map(len, cells.values())))
        in_brackets = {name: match[1].strip() for name in cells if (match := _UNIT.match(name))}
        units = {name: unit.strip("[]() ") for name, unit in zip(header, heading.units, strict=False) if unit}
        table = Table.of_cells(path, cells, in_brackets | units, decimal, heading.first_line + 1)
        table = replace(table, notes=[] if self.decimal else _doubtful_commas(path, heading.numbers, decimal))
        if rate is None:
            return table
        timeless = {name: values for name, values in table.columns.items() if name not in empty}
        return replace(table, columns=timeless, time=np.arange(len(table)) / rate)

    def _heading(self, lines: Sequence[str]) -> Heading:
        """Where the names are: by ``names_line``, else above the first rows of numbers."""
        first = None if self.names_line is None else self.names_line - 1
        for separator in SEPARATORS if self.separator is None else (self.separator,):
            heading = Heading.sought(lines, separator, first)
            if heading is not None:
                return heading
        separator = self.separator or ","
        rows = _numbered(lines, separator, first or 0)[:2]
        if not rows:
            raise csv.Error("it has no line of names")
        line, end, names = rows[0]
        return Heading(separator, line, end, [names], (), [cells for _, _, cells in rows[1:]])


@dataclass(frozen=True)
class Heading:
    """What stands above the numbers of a text. Lines are counted from 0.

    Attributes:
        separator: Between cells.
        line: That of the names.
        first_line: Of the numbers.
        names: A row of cells, or two.
        units: Cells; empty where no row has units.
        numbers: The first rows of numbers.
    """

    separator: str
    line: int
    first_line: int
    names: Sequence[list[str]]
    units: Sequence[str]
    numbers: Sequence[list[str]]

    @classmethod
    def sought(cls, lines: Sequence[str], separator: str, names_line: int | None) -> Heading | None:
        """Of a text with some separator; None: it has no table by it. Where no line of names is given it is sought."""
        try:
            rows = _numbered(lines, separator, names_line or 0)
        except (csv.Error, ValueError):
            return None
        cells = [row for _, _, row in rows]
        first = next((i for i in range(1, len(rows)) if _begins_numbers(cells[i:], cells[i - 1])), len(rows))
        below = _row_of_units(cells[:first])
        top = 0 if names_line is not None else _top(cells[:below])
        below, numbers = min(below, top + 2), cells[first : first + _LINES]
        if not top < first <= top + _MOST_ROWS or not numbers:
            return None
        # Units may stand further above the names, in a row that says so: Y_Unit_Label, N, g.
        above = [["", *row[1:]] for row in cells[:top] if row and _UNITS_FOLLOW.search(row[0])]
        names, units = cells[top:below], cells[below] if below < first else ([[], *above])[-1]
        width = max(map(_filled, names))
        spare = separator != BLANKS  # for comments, which no row has
        if width < 2 or any(not _filled(row) <= width <= max(len(row) + spare, 1) for row in numbers[1:] or numbers):
            return None
        return cls(separator, rows[top][0], rows[first][0], names, units, numbers)

    @property
    def header(self) -> list[str]:
        """A name of every column. Of two rows, a cell that is left empty above has the name to its left."""
        left, names = "", []
        for i, column in enumerate(zip_longest(*self.names, fillvalue="")):
            top, name = column if len(column) > 1 else ("", column[0])
            left = top or (left if name else "")
            times = next((cell for cell in (top, name) if cell and is_called_times(cell)), "")
            names.append(times or " ".join(filter(None, dict.fromkeys((left, name)))) or f"Unnamed: {i}")
        return names

    def check_names(self, path: Path) -> None:
        """Refuse numbers in the place of names, which would be lost. Columns may be counted: 0, 1, 2."""
        cells = [cell for cell in self.names[0] if cell]
        if self.numbers and all(map(_is_number, cells)) and not all(map(str.isdigit, cells)):
            hint = "write names above the numbers, such as t, force_1 [N], acc_1 [m/s^2]"
            raise InputError(f"{path.name}, line {self.line + 1}", ", ".join(cells[:3]), "names of the columns", hint)

    def check_columns(self, path: Path, asked: Mapping[str, str]) -> None:
        """Refuse a name that is asked for and there twice; and more cells in the first row of numbers than names.

        That row may end with separators.
        """
        names = self.header
        for setting, column in asked.items():
            if names.count(column) > 1:
                hint = f"it is there {names.count(column)} times: give each its own name"
                raise InputError(setting, repr(column), f"the name of one column of {path.name}", hint)
        filled = _filled(self.numbers[0]) if self.numbers else 0
        if filled > len(names):
            hint = f"a decimal comma, or a column without a name? Write one sample a line; or {_NAMES_LINE}"
            place = f"{path.name}, first row of numbers"
            raise InputError(place, f"{filled} cells", f"as many as the header has names, {len(names)}", hint)


def _cells(text: str, heading: Heading, decimal: str, names: Sequence[str]) -> dict[str, pd.Series]:
    """Columns by some of the names, from what stands below them. Blank lines are gaps, but for those at the end."""
    if not text.strip():
        return {name: pd.Series(dtype=np.float64) for name in names}
    places, above = [str(heading.header.index(name)) for name in names], heading.first_line - 1
    numbered = heading.separator.join(map(str, range(len(heading.header))))
    with warnings.catch_warnings():
        # Rows that end with a separator have a cell more than the names; it is no label.
        warnings.simplefilter("ignore", pd.errors.ParserWarning)
        frame = pd.read_csv(
            StringIO("\n" * above + f"{numbered}\n{text}"),  # so that errors have the file's lines
            sep=r"\s+" if heading.separator == BLANKS else heading.separator, decimal=decimal, usecols=places,
            index_col=False, skiprows=above, skip_blank_lines=False, skipinitialspace=True, low_memory=False,
        )  # fmt: skip
    filled = np.flatnonzero(frame.notna().any(axis=1))
    frame = frame.iloc[: filled[-1] + 1 if len(filled) else 0]
    return {name: frame[place] for name, place in zip(names, places, strict=True)}


def _numbered(lines: Sequence[str], separator: str, first: int) -> list[tuple[int, int, list[str]]]:
    """Rows with a cell, each with its first line and the one after it."""
    reader = csv.reader(lines[first:], delimiter=separator, skipinitialspace=True)
    rows, begin = [], first
    if separator == BLANKS:
        return [(i, i + 1, lines[i].split()) for i in range(first, len(lines)) if lines[i].strip()]
    for row in reader:
        cells = list(map(str.strip, row))
        if any(cells):
            rows.append((begin, first + reader.line_num, cells))
        begin = first + reader.line_num
    return rows


def _is_number(cell: str) -> bool:
    return bool(cell) and (_CELL.match(cell) is not None or _DATE.match(cell) is not None)


def _is_words(row: Sequence[str]) -> bool:
    return not any(map(_is_number, row))


def _begins_numbers(rows: Sequence[Sequence[str]], above: Sequence[str]) -> bool:
    """Whether numbers begin with the first of some rows: no row of words follows, or they stand right below names."""
    rows = rows[:_LINES]
    if not any(map(_is_words, rows)):
        cells = [cell for row in rows for cell in row if cell]
        return 2 * sum(map(_is_number, cells)) >= len(cells)
    below = all(all(map(_is_number, row)) for row in rows[:2])
    return below and _is_words(above) and _filled(above) == _filled(rows[0])


def _row_of_units(rows: Sequence[Sequence[str]]) -> int:
    """Of the rows above the numbers, that of the units; their number: there is none. What stands below it is no name.

    Below names that are all there it holds units, whether we know them or not, if it has one of the times.
    """
    for i in reversed(range(max(len(rows) - 2, 1), len(rows))):
        above, row = rows[i - 1], rows[i]
        complete = "" not in above and len(set(above)) == len(above)
        of_times = any(cell and is_called_times(name) for name, cell in zip(above, row, strict=False))
        named = _is_words(above) and _filled(above) > 1
        if all(map(_is_words, rows[i:])) and ((named and _is_units(row)) or (complete and of_times)):
            return i
    return len(rows)


def _top(rows: Sequence[Sequence[str]]) -> int:
    """Of the rows above the numbers and their units, the one where the names begin."""
    last = len(rows) - 1
    if last <= 0 or not _is_words(rows[last - 1]):
        return max(last, 0)
    above, names = rows[last - 1], rows[last]
    repeated = "" in names or len(set(names)) < len(names)
    timed, named = (any(map(is_called_times, row)) for row in (above, names))
    over = 1 < _filled(above) <= len(names) and (timed or 2 * sum(map(bool, above)) > len(names))
    return last - 1 if over and ((timed and not named) or (repeated and timed >= named)) else last


def _is_units(row: Sequence[str]) -> bool:
    """Whether half of the cells are units that we know, and none is the name of the times."""
    words = [cell for cell in row if cell not in ("", "-")]
    units = sum(_ONLY_UNIT.match(word) is not None for word in words)
    return bool(words) and 2 * units >= len(words) and not any(map(is_called_times, words))


def _filled(row: Sequence[str]) -> int:
    """Number of cells up to the last one that is filled."""
    return max((place for place, cell in enumerate(row, start=1) if cell), default=0)


def rate_above(lines: Sequence[str], decimal: str) -> float | None:
    """Hz, as lines above the names tell it: ``Sample rate [Hz]: 50``, ``dt = 0.02 s``; None: they do not."""
    number = rf"(?P<number>\d+(?:[{decimal}]\d+)?(?:[eE][+-]?\d+)?|[{decimal}]\d+)"
    for found in re.finditer(rf"(?P<name>[^\d\n]*?){number}[ \t]*(?P<unit>[A-Za-z]*)", "".join(lines)):
        name = found["name"].strip(" \t,;:=#%\"'")
        match = IN_BRACKETS.fullmatch(name)
        value = float(found["number"].replace(decimal, "."))
        rate = rate_of(match["name"] if match else name, value, match["unit"] if match else found["unit"])
        if rate is not None:
            return rate
    return None


def _decimal(rows: Sequence[Sequence[str]], separator: str) -> str:
    """The comma, where cells have decimals with commas and none with points; unless it groups digits."""
    cells = [cell for row in rows for cell in row]
    with_comma = [cell for cell in cells if _COMMA.match(cell)]
    if separator == "," or not with_comma or any(map(_POINT.match, cells)):
        return "."
    columns = ([cell for cell in column if cell] for column in zip_longest(*rows, fillvalue=""))
    grouped = all(map(may_group, with_comma)) and any(map(commas_group, columns))
    return "." if grouped else ","


def _doubtful_commas(path: Path, rows: Sequence[Sequence[str]], decimal: str) -> list[str]:
    """What is to be said where every comma that was taken for that of decimals may group digits."""
    with_comma = [cell for row in rows for cell in row if _COMMA.match(cell)]
    if decimal == "." or not all(map(may_group, with_comma)):
        return []
    shown = f"{with_comma[0]} is read as {with_comma[0].replace(',', '.')}"
    return [f"{path.name}: {shown}; data.format.decimal=. takes its comma for a sign between groups of digits"]
