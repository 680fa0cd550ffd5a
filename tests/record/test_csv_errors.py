"""What a file or a setting that cannot be used says: one line with file, column and line, or with the setting."""

import gzip
import math
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from refusals import refusal

from pinn_cli.record.measured_data import MeasuredData

SETTINGS = {"path": "rig.csv", "time": "t", "force": {1: "f"}, "acceleration": {1: "a1", 2: "a2"}}


def table() -> pd.DataFrame:
    time = np.round(0.01 * np.arange(100), 2)
    return pd.DataFrame({"t": time, "f": np.sin(time), "a1": np.cos(time), "a2": time**2})


def message(base: Path, ndof: int = 3, **changes) -> str:
    return refusal(lambda: MeasuredData(**{**SETTINGS, "base": base, **changes}).measure(ndof))


def with_cell(column: str, row: int, cell: object) -> pd.DataFrame:
    values = table().astype(object)
    values.loc[row, column] = cell
    return values


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (with_cell("f", 99, "overload"), "rig.csv, column 'f', line 101='overload'"),
        (with_cell("a1", 50, "inf"), "rig.csv, column 'a1', line 52='inf'"),
        (with_cell("t", 0, "2024-05-01T12:00:00.0"), "rig.csv, column 't', line 2='2024-05-01T12:00:00.0'"),
        (with_cell("a2", 0, "1,5"), "rig.csv, column 'a2', line 2='1,5'"),
        (table().assign(a1=table()["a1"] > 0), "rig.csv, column 'a1', line 2='True'"),
        (with_cell("a1", 5, "x" * 99), f"rig.csv, column 'a1', line 7='{'x' * 60}...': must be a finite number"),
        (table() * [1e300, 1, 1, 1], "rig.csv, column 't', line 101=9.9e+299, its largest number"),
        (table() * [1, 1, 1e-300, 1], "rig.csv, column 'a1', line 2=1e-300, its largest number"),
        (with_cell("t", 3, ""), "rig.csv, column 't', line 5=empty or NaN"),
        (with_cell("t", 3, 0.02), "rig.csv, column 't', line 5=0.02"),
        (table().assign(a2=np.nan), "data.acceleration.2='a2'"),
        (table().drop(columns="a2"), "data.acceleration.2='a2'"),
        (table().drop(columns="t"), "data.time='t'"),
        (table()[:10], "data.start, data.stop=None, None"),
        (table()[:0], "data.start, data.stop=None, None"),
    ],
)
def test_a_table_that_cannot_be_used(tmp_path, values, expected):
    values.to_csv(tmp_path / "rig.csv", index=False)
    assert message(tmp_path).startswith(expected)


@pytest.mark.parametrize("above", ["", "\n\n"])
def test_numbers_are_no_names(tmp_path, above):
    rows = table().to_csv(index=False, header=False)
    (tmp_path / "rig.csv").write_text(above + rows)
    line = 1 + above.count("\n")
    assert message(tmp_path).startswith(f"rig.csv, line {line}=0.0, 0.0, 1.0: must be names of the columns")
    (tmp_path / "rig.csv").write_text("0,1,2,3\n" + rows)
    assert not message(tmp_path, time="0", force={1: "1"}, acceleration={1: "2", 2: "9"}).startswith("rig.csv, line 1")


def test_a_blank_line_in_the_middle_is_a_gap_on_its_own_line(tmp_path):
    lines = table().to_csv(index=False).splitlines()
    (tmp_path / "rig.csv").write_text("\n".join([*lines[:20], "", *lines[20:]]))
    assert message(tmp_path).startswith("rig.csv, column 't', line 21=empty or NaN")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "must be a readable file of comma-separated values"),
        (b"t,f,a1,a2\n1,2,3,4\n1,2,3,4,5,6\n", "line 3"),
        (b"t;f;a1;a2\n0;1;2;3\n", "must be a window of at least 16 samples; rig.csv has 1 rows"),
        (b"t;f;a1\n0;1;2\n", "data.acceleration.2='a2'"),
        (b"\xff\xfe\x00\xd8", "rig.csv, line 1=byte 0x00"),
        (b"t,f,a1,a2\n0,1,2,\x81\n", "rig.csv, line 2=byte 0x81"),
        (b"t,f,a1,a2\n0,1,\x00,2\n", "rig.csv, line 2=byte 0x00"),
        (gzip.compress(b"t,f,a1,a2\n0,1,2,3\n" * 99, mtime=0)[:40], "must be a gzip file that is whole; damaged"),
        (b"PK\x03\x04 no more", "must be a text file; it is a zip archive or a spreadsheet (data=excel): unpack it"),
        (b"t,f,a1,a1,a2\n0,1,2,3,4\n", "data.acceleration.1='a1'"),
        (b"t,f,a1,a2," + b"x" * 140_000 + b"\n0,1,2,3,4\n", "must be a readable file"),
        (b"t,f,a1,A2\n", "which has 't', 'f', 'a1', 'A2'"),
        (b"t,f,a1," + b",".join(b"c%d" % i for i in range(900)) + b"\n", "'c15', 'c16' and 883 more"),
    ],
)
def test_a_file_that_is_no_csv(tmp_path, content, expected):
    (tmp_path / "rig.csv").write_bytes(content)
    assert expected in message(tmp_path)


@pytest.mark.parametrize("name", ["rig.csv.bz2", "rig.zip"])
def test_a_packed_file_is_to_be_unpacked_whatever_is_in_it(tmp_path, name):
    (tmp_path / name).write_bytes(b"hello")
    assert message(tmp_path, path=name).startswith(f"data.path={tmp_path / name}: must be a text file; unpack it")


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "rig.csv")
    assert "it is a pipe or a device" in message(tmp_path)


def test_a_file_beyond_memory(tmp_path, monkeypatch):
    table().to_csv(tmp_path / "rig.csv", index=False)
    monkeypatch.setattr("pinn_cli.record.files.on_disk.of_this_machine", lambda: 2**10)
    assert "must be a file of at most 5.96e-08 GiB" in message(tmp_path)


@pytest.mark.parametrize("path", ["nowhere\0.csv", "~nobody-of-that-name/rig.csv", "n" * 300])
def test_a_path_that_leads_nowhere(tmp_path, path):
    assert message(tmp_path, path=path).startswith(f"data.path={tmp_path / path}: must be a ")


def test_a_missing_file_is_named_with_the_folder_it_was_looked_for_in(tmp_path):
    assert message(tmp_path).startswith(f"data.path={tmp_path / 'rig.csv'}: must be a file that exists")
    assert message(tmp_path, path=str(tmp_path)).startswith(
        f"data.path={tmp_path}: must be a readable file; it is a folder"
    )


@pytest.mark.parametrize(
    ("expected", "changes"),
    [
        ("data.path=None", {"path": None}),
        ("data.time=", {"time": ""}),
        ("data.acceleration=3", {"ndof": 2, "acceleration": {1: "a1", 3: "a2"}}),
        ("data.force=0", {"force": {0: "f"}}),
        ("data.velocity=one", {"velocity": {"one": "a2"}}),
        ("data.velocity=a2", {"velocity": "a2"}),
        ("data.velocity=1", {"velocity": {1: "v1", "1": "v2"}}),
        ("data.velocity.1=None", {"velocity": {1: None}}),
        ("data.velocity.2=5", {"velocity": {2: 5}}),
        ("data.acceleration.2='a1'", {"acceleration": {1: "a1", 2: "a1"}}),
        ("data.displacement, data.velocity, data.acceleration={}", {"acceleration": {}}),
        ("data.holdout=3", {"holdout": [3]}),
        ("data.holdout=[1, 2]", {"holdout": [1, 2]}),
        ("data.holdout=2", {"holdout": 2}),
        ("data.start=0.5", {"start": 0.5, "stop": 0.5}),
        ("data.start=nan", {"start": math.nan}),
        ("data.stop=end", {"stop": "end"}),
        ("data.start, data.stop=0.5, 0.6", {"start": 0.5, "stop": 0.6}),
        ("data.start, data.stop=7.0, None", {"start": 7.0}),
        ("data.start, data.stop=None, None", {"decimate": 10}),
        ("data.decimate=0", {"decimate": 0}),
        ("data.decimate=2.5", {"decimate": 2.5}),
        ("data.decimate=2", {"decimate": 2, "intersample": "zero_order_hold"}),
        ("data.intersample=linear", {"intersample": "linear"}),
    ],
)
def test_a_setting_that_cannot_be_used(tmp_path, expected, changes):
    table().to_csv(tmp_path / "rig.csv", index=False)
    assert re.match(re.escape(expected), message(tmp_path, **changes))


def test_more_cells_than_names(tmp_path):
    """As of a decimal comma: pandas alone would read 0,00 as two cells, and the next column from the second."""
    lines = [f"0,{i:02d},0,5,1,25,{i},3" for i in range(100)]
    (tmp_path / "rig.csv").write_text("\n".join(["t,f,a1,a2", *lines]) + "\n")
    told = message(tmp_path)
    assert told.startswith("rig.csv, first row of numbers=8 cells")
    assert "decimal comma" in told


@pytest.mark.parametrize("value", [0.0, -3.25])
def test_a_dead_sensor_is_named(tmp_path, value):
    table().assign(a2=value).to_csv(tmp_path / "rig.csv", index=False)
    told = message(tmp_path)
    assert told.startswith("data.acceleration.2='a2'")
    assert f"every sample of it is {value:g}: a dead sensor?" in told
