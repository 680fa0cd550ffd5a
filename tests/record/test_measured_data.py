"""Records from text: what goes where; of what is unusable one line with file, column and line, or with the setting."""

import gzip
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import refusal
from omegaconf import OmegaConf

from pinn_cli.cli.records import data_of_records
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.settings.instantiation import build

CONF = Path(__file__).parents[2] / "conf" / "data" / "csv.yaml"
SHARED = CONF.with_name("_measured.yaml")
STEP = 0.01
ROWS = 200


def table() -> pd.DataFrame:
    time = np.round(STEP * np.arange(ROWS), 2)
    channels = {name: np.sin((i + 1.0) * time + i) for i, name in enumerate(["f1", "u1", "v2", "a1", "a2", "a3"])}
    return pd.DataFrame({"t (s)": time, **channels})


@pytest.fixture
def rig(tmp_path) -> Path:
    table().to_csv(tmp_path / "rig.csv", index=False)
    return tmp_path


SETTINGS = {
    "path": "rig.csv",
    "time": "t (s)",
    "force": {1: "f1"},
    "displacement": {1: "u1"},
    "velocity": {2: "v2"},
    "acceleration": {1: "a1", 2: "a2", 3: "a3"},
}


def read(base: Path, ndof: int = 4, **changes):
    return MeasuredData(**{**SETTINGS, "base": base, **changes}).measure(ndof)


def test_columns_go_where_the_settings_say(rig):
    record = read(rig).record
    values = table()
    assert record.ndof == 4
    assert record.sampling_rate == pytest.approx(100.0)
    np.testing.assert_allclose(record.time, values["t (s)"], atol=1e-12)
    np.testing.assert_allclose(record.velocity[:, 1], values["v2"], rtol=1e-12)
    np.testing.assert_allclose(record.acceleration[:, 2], values["a3"], rtol=1e-12)
    np.testing.assert_allclose(record.force[:, 0], values["f1"], rtol=1e-12)
    assert record.sensors("displacement").tolist() == [True, False, False, False]
    assert record.sensors("velocity").tolist() == [False, True, False, False]
    assert record.sensors("acceleration").tolist() == [True, True, True, False]
    assert record.unforced.tolist() == [False, True, True, True]
    assert not record.force[:, 1:].any()
    assert record.intersample == "band_limited"


def test_a_held_out_dof_is_in_the_truth_and_nowhere_else(rig):
    measurements = read(rig, holdout=[2])
    record, truth = measurements.record, measurements.truth.response
    values = table()
    assert np.isnan(record.velocity).all()
    assert np.isnan(record.acceleration[:, 1]).all()
    assert record.observed.tolist() == [True, False, True, False]
    np.testing.assert_allclose(truth.velocity[:, 1], values["v2"], rtol=1e-12)
    np.testing.assert_allclose(truth.acceleration[:, 1], values["a2"], rtol=1e-12)
    known = [np.isfinite(getattr(truth, q)).all(axis=0) for q in ("displacement", "velocity", "acceleration", "force")]
    assert np.array(known).sum() == 2
    assert measurements.truth.parameters is None


def test_a_force_that_is_not_measured_is_unknown(rig):
    unmeasured = read(rig, force={1: "f1", 3: None})
    assert np.isnan(unmeasured.record.force[:, 2]).all()
    assert unmeasured.record.unforced.tolist() == [False, True, False, True]
    assert read(rig, force={}).record.unforced.all()


def test_the_window_includes_its_ends_and_keeps_the_files_times(rig):
    record = read(rig, start=0.5, stop=1.2).record
    assert record.time[[0, -1]] == pytest.approx([0.5, 1.2])
    assert len(record.time) == 71
    np.testing.assert_allclose(record.acceleration[:, 0], table()["a1"][50:121], rtol=1e-12)


def test_decimation_filters_force_and_response_alike(rig):
    whole, kept = read(rig).record, read(rig, decimate=4).record
    assert kept.sampling_rate == pytest.approx(25.0)
    np.testing.assert_allclose(kept.time, whole.time[::4])
    for quantity, dof in (("force", 0), ("velocity", 1), ("acceleration", 2)):
        np.testing.assert_allclose(getattr(kept, quantity)[:, dof], getattr(whole, quantity)[::4, dof], atol=5e-3)


def test_trailing_blank_lines_and_columns_that_nobody_asked_for_do_no_harm(rig):
    text = (rig / "rig.csv").read_text().splitlines()
    text = [text[0] + ",note", *(row + ",ok" for row in text[1:])]
    (rig / "rig.csv").write_text("\ufeff" + "\n".join(text) + "\n\n\n")
    assert len(read(rig).record.time) == ROWS


def test_a_gap_outside_the_window_is_no_matter(rig):
    values = table()
    values.loc[150, "a1"] = np.nan
    values.drop(index=range(160, 165)).to_csv(rig / "rig.csv", index=False)
    assert len(read(rig, stop=1.0).record.time) == 101
    assert not read(rig, stop=1.0).record.calibrated
    (channel,) = read(rig, stop=1.55).record.calibrated
    assert (channel.key, len(channel.time)) == ("a1", 155)


@pytest.mark.parametrize(("begin", "decimals"), [(0.0, 3), (0.0, 6), (1.7e9, 4)])
def test_times_printed_with_few_digits_are_uniform(rig, begin, decimals):
    values = table()
    values["t (s)"] = [f"{begin + row / 256.0:.{decimals}f}" for row in range(ROWS)]
    values.to_csv(rig / "rig.csv", index=False)
    record = read(rig).record
    assert record.sampling_rate == pytest.approx(256.0, rel=1e-3)
    assert np.ptp(np.diff(record.time)) < 1e-12


def test_dofs_may_come_as_text_and_a_missing_map_as_null(rig):
    record = read(rig, acceleration={"1": "a1", "3": "a3"}, displacement=None, velocity={}).record
    assert record.sensors("acceleration").tolist() == [True, False, True, False]


def test_the_config_lists_every_setting_and_reads_the_file(rig):
    of_csv = {name: value for name, value in OmegaConf.load(CONF).items() if name != "defaults"}
    settings = OmegaConf.merge(OmegaConf.load(SHARED), of_csv, {**SETTINGS, "holdout": [2]})
    fields = set(MeasuredData.__dataclass_fields__) - {"base", "responds"}
    assert set(settings) - {"_target_", "records", "window", "overlap"} == fields
    (own,) = data_of_records(settings)
    source = build(own, "data", base=rig)
    assert source.measure(3).record.observed.tolist() == [True, False, True]


def test_cristallo_is_read_by_its_own_settings(shared):
    settings = OmegaConf.to_container(OmegaConf.load(shared / "data" / "cristallo" / "cristallo.yaml"))
    measurements = MeasuredData(**settings, base=shared).measure(3)
    record, truth = measurements.record, measurements.truth.response
    assert len(record.time) == 5001
    assert record.sampling_rate == pytest.approx(250.0)
    assert record.sensors("velocity").tolist() == [True, False, True]
    assert record.sensors("force").tolist() == [True, False, False]
    assert record.unforced.tolist() == [False, True, True]
    assert np.isfinite(truth.velocity[:, 1]).all()
    assert np.isnan(truth.velocity[:, [0, 2]]).all()


@pytest.mark.parametrize("header", ["", ",", ",,"])
@pytest.mark.parametrize("row", ["", ",", ",,"])
def test_rows_may_end_with_commas(rig, header, row):
    expected = read(rig).record
    lines = (rig / "rig.csv").read_text().splitlines()
    (rig / "rig.csv").write_text("\n".join([lines[0] + header, *(line + row for line in lines[1:])]) + "\n")
    record = read(rig).record
    for quantity in ("time", "displacement", "velocity", "acceleration", "force"):
        np.testing.assert_array_equal(getattr(record, quantity), getattr(expected, quantity))


PLAIN = {"path": "rig.csv", "time": "t", "force": {1: "f"}, "acceleration": {1: "a1", 2: "a2"}}


def plain() -> pd.DataFrame:
    time = np.round(0.01 * np.arange(100), 2)
    return pd.DataFrame({"t": time, "f": np.sin(time), "a1": np.cos(time), "a2": time**2})


def message(base: Path, ndof: int = 3, **changes) -> str:
    return refusal(lambda: MeasuredData(**{**PLAIN, "base": base, **changes}).measure(ndof))


def with_cell(column: str, row: int, cell: object) -> pd.DataFrame:
    values = plain().astype(object)
    values.loc[row, column] = cell
    return values


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (with_cell("f", 99, "overload"), "rig.csv, column 'f', line 101='overload'"),
        (with_cell("a1", 50, "inf"), "rig.csv, column 'a1', line 52='inf'"),
        (with_cell("t", 0, "2024-05-01T12:00:00.0"), "rig.csv, column 't', line 2='2024-05-01T12:00:00.0'"),
        (with_cell("a2", 0, "1,5"), "rig.csv, column 'a2', line 2='1,5'"),
        (plain().assign(a1=plain()["a1"] > 0), "rig.csv, column 'a1', line 2='True'"),
        (with_cell("a1", 5, "x" * 99), f"rig.csv, column 'a1', line 7='{'x' * 60}...': must be a finite number"),
        (plain() * [1e300, 1, 1, 1], "rig.csv, column 't', line 101=9.9e+299, its largest number"),
        (with_cell("t", 3, ""), "rig.csv, column 't', line 5=empty or NaN"),
        (with_cell("t", 3, 0.02), "rig.csv, column 't', line 5=0.02"),
        (plain().assign(a2=np.nan), "data.acceleration.2='a2'"),
        (plain().drop(columns="a2"), "data.acceleration.2='a2'"),
        (plain().drop(columns="t"), "data.time='t'"),
        (plain()[:10], "data.start, data.stop=None, None"),
    ],
)
def test_a_table_that_cannot_be_used(tmp_path, values, expected):
    values.to_csv(tmp_path / "rig.csv", index=False)
    assert message(tmp_path).startswith(expected)


@pytest.mark.parametrize("above", ["", "\n\n"])
def test_numbers_are_no_names(tmp_path, above):
    rows = plain().to_csv(index=False, header=False)
    (tmp_path / "rig.csv").write_text(above + rows)
    line = 1 + above.count("\n")
    assert message(tmp_path).startswith(f"rig.csv, line {line}=0.0, 0.0, 1.0: must be names of the columns")
    (tmp_path / "rig.csv").write_text("0,1,2,3\n" + rows)
    assert not message(tmp_path, time="0", force={1: "1"}, acceleration={1: "2", 2: "9"}).startswith("rig.csv, line 1")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "must be a readable file of comma-separated values"),
        (b"t,f,a1,a2\n1,2,3,4\n1,2,3,4,5,6\n", "line 3"),
        (plain().to_csv(index=False).replace("\n0.2,", "\n\n0.2,").encode(), "column 't', line 22=empty or NaN"),
        (b"t,f,a1,a2\n" + b"0,01,0,5,1,25,3,3\n" * 9, "first row of numbers=8 cells"),  # as of decimal commas
        (b"t;f;a1;a2\n0;1;2;3\n", "must be a window of at least 16 samples; rig.csv has 1 rows"),
        (b"t;f;a1\n0;1;2\n", "data.acceleration.2='a2'"),
        (b"\xff\xfe\x00\xd8", "rig.csv: must be text in utf-16; "),
        (b"t,f,a1,a2\n0,1,2,\x81\n", "rig.csv: must be text in utf-8 or cp1252"),
        (b"t,f,a1,a2\n0,1,\x00,2\n", "rig.csv: must be text in utf-8 or cp1252"),
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


@pytest.mark.parametrize("path", ["nowhere\0.csv", "~nobody-of-that-name/rig.csv", "n" * 300, ".", "pipe", "none.csv"])
def test_a_path_that_leads_to_no_file(tmp_path, path):
    os.mkfifo(tmp_path / "pipe")  # which is not waited for
    hint = {".": "; it is a folder", "pipe": "; it is a pipe or a device", "none.csv": "a file that exists"}
    told = message(tmp_path, path=path)
    assert told.startswith(f"data.path={tmp_path / path}: must be a ")
    assert hint.get(path, "") in told


def test_a_file_beyond_memory(tmp_path, monkeypatch):
    plain().to_csv(tmp_path / "rig.csv", index=False)
    monkeypatch.setattr("pinn_cli.record.files.file_format.of_this_machine", lambda: 2**10)
    assert "must be a file of at most 5.96e-08 GiB" in message(tmp_path)


@pytest.mark.parametrize(
    ("expected", "changes"),
    [
        ("data.path=None", {"path": None}),
        ("data.time=", {"time": ""}),
        ("data.acceleration=3", {"ndof": 2, "acceleration": {1: "a1", 3: "a2"}}),
        ("data.force=0", {"force": {0: "f"}}),
        ("data.velocity=a2", {"velocity": "a2"}),
        ("data.velocity=1", {"velocity": {1: "v1", "1": "v2"}}),
        ("data.velocity.1=None", {"velocity": {1: None}}),
        ("data.acceleration.2='a1'", {"acceleration": {1: "a1", 2: "a1"}}),
        ("data.displacement, data.velocity, data.acceleration={}", {"acceleration": {}}),
        ("data.holdout=3", {"holdout": [3]}),
        ("data.holdout=[1, 2]", {"holdout": [1, 2]}),
        ("data.holdout=2", {"holdout": 2}),
        ("data.start=0.5", {"start": 0.5, "stop": 0.5}),
        ("data.stop=end", {"stop": "end"}),
        ("data.start, data.stop=0.5, 0.6", {"start": 0.5, "stop": 0.6}),
        ("data.decimate=0", {"decimate": 0}),
        ("data.decimate=2", {"decimate": 2, "intersample": "zero_order_hold"}),
        ("data.intersample=linear", {"intersample": "linear"}),
    ],
)
def test_a_setting_that_cannot_be_used(tmp_path, expected, changes):
    plain().to_csv(tmp_path / "rig.csv", index=False)
    assert re.match(re.escape(expected), message(tmp_path, **changes))


@pytest.mark.parametrize("value", [0.0, -3.25])
def test_a_dead_sensor_is_named(tmp_path, value):
    plain().assign(a2=value).to_csv(tmp_path / "rig.csv", index=False)
    told = message(tmp_path)
    assert told.startswith("data.acceleration.2='a2'")
    assert f"every sample of it is {value:g}: a dead sensor?" in told
