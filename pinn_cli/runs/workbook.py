"""Tables as an Excel file, by openpyxl: a sheet for each."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinn_cli.runs.reading import printable
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import pandas

SUFFIX = ".xlsx"
# What a sheet holds, and how long its name may be.
SHEET_ROWS, SHEET_COLUMNS, LONGEST_SHEET_NAME = 2**20, 2**14, 31


def write_workbook(tables: Mapping[str, pandas.DataFrame], path: str | os.PathLike[str]) -> Path:
    """Write tables, names of columns in the first row; cells that are NaN or None are empty, texts are never formulas.

    Args:
        tables: Name of a sheet to its table.
        path: Of the file; one of that name is replaced.

    Raises:
        InputError: Naming ``path``: it has another suffix, a table does not fit into a sheet, no openpyxl.
        WriteError: The disk does not take it.
    """
    place = Path(path).expanduser()
    if place.suffix.lower() != SUFFIX:
        raise InputError("path", path, f"a file whose name ends with {SUFFIX}")
    if find_spec("openpyxl") is None:
        raise InputError("path", path, "written where openpyxl is installed", "pip install 'pinn-cli[excel]'")
    for name, table in tables.items():
        if len(table) >= SHEET_ROWS or len(table.columns) > SHEET_COLUMNS:
            shown = f"{name} of {len(table)} rows and {len(table.columns)} columns"
            hint = f"{name}.csv has all of it"
            raise InputError("path", shown, f"tables of less than {SHEET_ROWS} rows and {SHEET_COLUMNS} columns", hint)
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    for name, table in tables.items():
        sheet = book.create_sheet(re.sub(r"[\[\]:*?/\\]", "_", printable(name))[:LONGEST_SHEET_NAME])
        sheet.freeze_panes = "A2"
        sheet.append([_cell(sheet, str(column)) for column in table.columns])
        for row in table.itertuples(index=False, name=None):
            sheet.append([_cell(sheet, value) for value in row])
    with replacing(place) as temporary:
        book.save(temporary)
    return place


def _cell(sheet: Any, value: Any) -> Any:
    """A number or a Boolean as such; a text as one, whatever it begins with; what is none of these is left empty."""
    from openpyxl.cell import WriteOnlyCell

    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int):
        return value
    cell = WriteOnlyCell(sheet, printable(str(value)))
    cell.data_type = "s"  # "=..." would be a formula, and Excel evaluates them
    return cell
