"""Files are there whole or not at all, tables in an Excel file too."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pinn_cli.runs import workbook
from pinn_cli.runs.workbook import write_workbook
from pinn_cli.runs.writing import WriteError, put_back, replacing, replacing_by_large, write_json, write_table
from pinn_cli.settings.errors import InputError


def _fail_halfway(place: Path) -> None:
    with replacing(place) as beside:
        beside.write_text("half")
        raise KeyboardInterrupt


def test_an_interrupted_file_leaves_the_old_one(tmp_path):
    place = tmp_path / "fitness.csv"
    place.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        _fail_halfway(place)
    assert place.read_text() == "old"
    assert list(tmp_path.iterdir()) == [place]


def test_empty_cells_stay_empty(tmp_path):
    table = pd.DataFrame({"case": ["a", "b"], "snr_db": [None, 50.0], "value": [np.nan, 1 / 3]})
    assert write_table(table, tmp_path / "t.csv").read_text() == "case,snr_db,value\na,,\nb,50,0.3333333333\n"


def test_json_is_strict_and_takes_numpy(tmp_path):
    content = {
        "seconds": {"total": np.float64(1.5)},
        "seed": np.int64(3),
        "bad": [np.nan, np.inf],
        "ok": np.bool_(True),
    }
    content |= {"array": np.arange(2), "path": Path("a"), "nothing": None}
    read = json.loads(write_json(content, tmp_path / "run.json").read_text(), parse_constant=pytest.fail)
    assert read["seconds"] == {"total": 1.5}
    assert (read["seed"], read["bad"], read["ok"], read["array"], read["path"]) == (3, [None, None], True, [0, 1], "a")
    with pytest.raises(TypeError, match="cannot hold"):
        write_json({"x": object()}, tmp_path / "other.json")
    assert [file.name for file in tmp_path.iterdir()] == ["run.json"]


def test_what_was_no_file_is_not_removed_when_it_is_put_back(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("nowhere")
    (tmp_path / "new").write_text("of the program")
    for name in ("pipe", "link", "new", "nothing"):
        put_back(tmp_path / name, None)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["link", "pipe"]


def test_a_full_disk_is_told_before_a_large_file_is_written(tmp_path, monkeypatch):
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "response.nc").write_bytes(b"old")
    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with pytest.raises(WriteError, match="No space left"), replacing_by_large(tmp_path / "response.nc", 100):
        pytest.fail("the block was entered")
    assert [place.read_bytes() for place in tmp_path.iterdir()] == [b"old"]


def test_numbers_texts_and_empty_cells(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    table = pd.DataFrame({"k": [-1.2345678901e-9, np.nan], "n": [3, 4], "sound": [True, False], "dof": ["roof", None]})
    path = write_workbook({"parameters": table, "a/b": table.iloc[:0]}, tmp_path / "out" / "tables.xlsx")
    book = openpyxl.load_workbook(path)
    assert book.sheetnames == ["parameters", "a_b"]
    rows = list(book["parameters"].iter_rows(values_only=True))
    assert rows == [("k", "n", "sound", "dof"), (-1.2345678901e-9, 3, True, "roof"), (None, 4, False, None)]
    assert [file.name for file in path.parent.iterdir()] == ["tables.xlsx"]


def test_what_files_of_others_say_is_text(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    evil = ["=1+1", "#N/A", "bell\a"]
    path = write_workbook({"x": pd.DataFrame({"=cmd|' /C calc'!A0": evil})}, tmp_path / "x.xlsx")
    cells = [row[0] for row in openpyxl.load_workbook(path)["x"].iter_rows()]
    assert [cell.data_type for cell in cells] == ["s"] * 4
    assert [cell.value for cell in cells[1:]] == ["=1+1", "#N/A", r"bell\x07"]


def test_what_is_refused_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openpyxl")
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
