"""Tables in an Excel file: what is read back, and what Excel would make of the cells."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pinn_cli.runs import workbook
from pinn_cli.runs.workbook import write_workbook
from pinn_cli.settings.errors import InputError

openpyxl = pytest.importorskip("openpyxl")


def test_numbers_texts_and_empty_cells(tmp_path: Path) -> None:
    table = pd.DataFrame({"k": [-1.2345678901e-9, np.nan], "n": [3, 4], "sound": [True, False], "dof": ["roof", None]})
    path = write_workbook({"parameters": table, "a/b": table.iloc[:0]}, tmp_path / "out" / "tables.xlsx")
    book = openpyxl.load_workbook(path)
    assert book.sheetnames == ["parameters", "a_b"]
    rows = list(book["parameters"].iter_rows(values_only=True))
    assert rows == [("k", "n", "sound", "dof"), (-1.2345678901e-9, 3, True, "roof"), (None, 4, False, None)]
    assert [file.name for file in path.parent.iterdir()] == ["tables.xlsx"]


def test_what_files_of_others_say_is_text(tmp_path: Path) -> None:
    evil = ["=1+1", "#N/A", "bell\a"]
    path = write_workbook({"x": pd.DataFrame({"=cmd|' /C calc'!A0": evil})}, tmp_path / "x.xlsx")
    cells = [row[0] for row in openpyxl.load_workbook(path)["x"].iter_rows()]
    assert [cell.data_type for cell in cells] == ["s"] * 4
    assert [cell.value for cell in cells[1:]] == ["=1+1", "#N/A", r"bell\x07"]


def test_what_is_refused_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = pd.DataFrame({"a": [1, 2, 3]})
    with pytest.raises(InputError, match=r"path=.*x.csv: must be a file whose name ends with .xlsx"):
        write_workbook({"x": table}, tmp_path / "x.csv")
    monkeypatch.setattr(workbook, "SHEET_ROWS", 3)
    with pytest.raises(InputError, match=r"path=x of 3 rows and 1 columns: must be tables of less than 3 rows"):
        write_workbook({"x": table}, tmp_path / "x.xlsx")
    monkeypatch.setattr(workbook, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'pinn-cli\[excel\]'"):
        write_workbook({}, tmp_path / "x.xlsx")
    assert not list(tmp_path.iterdir())
