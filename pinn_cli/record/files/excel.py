"""Excel files, by openpyxl: a sheet as the text that it would be saved as, read as such."""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.file_format import ArrayFormat
from pinn_cli.record.files.table import Table, listed, shortened
from pinn_cli.record.files.variables import Variable
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.settings.errors import InputError, suggestion

if TYPE_CHECKING:
    from openpyxl.workbook import Workbook


@dataclass(frozen=True)
class ExcelFormat(ArrayFormat):
    """Columns by their names, as in text. Of a formula its last value is read, and nothing is evaluated.

    Attributes:
        sheet: Its name; None: the one with most rows of numbers.
        names_line: Row of the columns' names, as of text.
    """

    sheet: str | None = None
    names_line: int | None = None

    name = "excel"
    suffixes = (".xlsx", ".xlsm")
    expected = "an Excel file (.xlsx)"
    beginnings = (b"PK\x03\x04",)
    package = "openpyxl"

    def __post_init__(self) -> None:
        if self.sheet is not None and not isinstance(self.sheet, str):
            raise InputError("data.format.sheet", self.sheet, "null or the name of a sheet")
        self._text_format()

    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """A sheet has rows, no arrays."""
        raise NotImplementedError

    def read_tables(self, path: Path, wanted: Mapping[str, str] | None) -> list[Table]:
        """See :class:`ArrayFormat`."""
        from openpyxl import load_workbook

        text, notes = self._text(load_workbook(path, read_only=True, data_only=True), path)
        table = self._text_format().table(path, text, wanted)
        return [replace(table, notes=[*table.notes, *notes])]

    def _text_format(self) -> CsvFormat:
        return CsvFormat(separator="\t", decimal=".", names_line=self.names_line)

    def _text(self, book: Workbook, path: Path) -> tuple[str, list[str]]:
        """A sheet as text, and what is to be said of the others."""
        sheets = {sheet.title: sheet for sheet in book.worksheets}
        if self.sheet is not None and self.sheet not in sheets:
            allowed = f"a sheet of {path.name}: {', '.join(sheets)}"
            raise InputError("data.format.sheet", self.sheet, allowed, suggestion(self.sheet, sheets))
        most, chosen, filled = int(self.sheet is None), "", []
        for title in sheets if self.sheet is None else [self.sheet]:
            text = StringIO()
            rows = csv.writer(text, delimiter="\t", lineterminator="\n")
            numbers = 0
            for row in sheets[title].iter_rows(values_only=True):
                numbers += any(isinstance(cell, int | float) for cell in row)
                rows.writerow(_written(row))
            filled += [title] if numbers >= MINIMUM_SAMPLES else []
            if numbers >= most:
                most, chosen, chosen_text = numbers + 1, title, text.getvalue()
        if not chosen:
            raise InputError("data.path", path, "a file with a sheet of numbers", f"it has {', '.join(sheets)}")
        others = [title for title in filled if title != chosen]
        text_of = f"{path.name}: the sheet {shortened(chosen)} is read; data.format.sheet=... takes {listed(others)}"
        return chosen_text, [text_of] if others else []


def _written(row: tuple[Any, ...]) -> Iterator[str]:
    """Cells as text; what Excel shows as a date or a time of day as ISO 8601 writes it."""
    for cell in row:
        if isinstance(cell, timedelta):
            yield repr(cell.total_seconds())
        elif isinstance(cell, datetime | date | time):
            yield cell.isoformat()
        else:
            yield "" if cell is None else str(cell)
