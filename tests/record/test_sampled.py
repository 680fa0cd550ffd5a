"""Records with gaps, several rates and jitter, and the data on which the identified system is tried."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import refusal

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Record
from pinn_cli.record.validation_data import ValidationData
from pinn_cli.settings.errors import InputError

ROWS, STEP = 400, 0.01
TIME = np.round(STEP * np.arange(ROWS), 4)
SETTINGS = {"time": "t", "force": {1: "f"}, "acceleration": {1: "a1", 2: "a2"}}


def table(time: np.ndarray = TIME) -> pd.DataFrame:
    return pd.DataFrame({"t": time, "f": np.sin(9 * time), "a1": np.cos(7 * time), "a2": np.sin(5 * time)})


def read(folder: Path, values: pd.DataFrame, **changes) -> Record:
    values.to_csv(folder / "rig.csv", index=False)
    return MeasuredData("rig.csv", base=folder, **{**SETTINGS, **changes}).measure(2).record


def emptied(column: str, where: np.ndarray) -> pd.DataFrame:
    values = table()
    values.loc[where, column] = np.nan
    return values


@pytest.mark.parametrize(
    "where",
    [
        np.random.default_rng(0).random(ROWS) < 0.5,
        np.arange(ROWS) % 5 > 0,
        (np.arange(ROWS) > 150) & (np.arange(ROWS) < 230),
        np.arange(ROWS) < 30,
    ],
    ids=["half at random", "a fifth of the rate", "a gap", "a late start"],
)
def test_missing_samples_of_one_channel(tmp_path, where):
    values = emptied("a1", where)
    record = read(tmp_path, values)
    (channel,) = record.calibrated
    np.testing.assert_allclose(channel.time, TIME[~where], atol=1e-12)
    np.testing.assert_array_equal(channel.measured, values["a1"][~where])
    assert (channel.key, channel.place, channel.calibration) == ("a1", ("acceleration", 0), {})
    np.testing.assert_allclose(record.acceleration[~where, 0], values["a1"][~where], atol=1e-12)
    assert np.isfinite(record.acceleration[:, 0]).all()
    assert record.plain("acceleration").tolist() == [False, True]
    np.testing.assert_array_equal(record.acceleration[:, 1], values["a2"])


@pytest.mark.parametrize("jitter", [0.1, 0.4])
def test_jitter_leaves_every_sample_at_its_own_time(tmp_path, caplog, jitter):
    time = TIME + jitter * STEP * np.random.default_rng(1).uniform(-1.0, 1.0, ROWS)
    with caplog.at_level(logging.WARNING):
        record = read(tmp_path, table(time))
    assert "the times are uneven: every sample is used at its own time" in caplog.text
    assert sorted(channel.key for channel in record.calibrated) == ["a1", "a2", "f"]
    for channel in record.calibrated:
        np.testing.assert_array_equal(channel.time, time)
    assert (record.time[0], record.time[-1]) == (time[0], time[-1])
    assert np.ptp(np.diff(record.time)) < 1e-12
    np.testing.assert_allclose(record.acceleration[:, 0], np.cos(7 * record.time), atol=5e-3)
    assert refusal(read, tmp_path, table(time), holdout=[2]).startswith("data.holdout=[2]")


def test_several_files_whose_rates_do_not_divide_each_other(tmp_path):
    """Their times together are uneven. Those of the fastest file are the record's."""
    slow = np.arange(250) / 64.0 + 0.013
    table().drop(columns="a2").to_csv(tmp_path / "fast.csv", index=False)
    pd.DataFrame({"t": slow, "a2": np.sin(5 * slow)}).to_csv(tmp_path / "slow.csv", index=False)
    record = MeasuredData(["fast.csv", "slow.csv"], base=tmp_path, **SETTINGS).measure(2).record
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)
    (channel,) = record.calibrated
    assert channel.key == "a2"
    np.testing.assert_allclose(channel.time, slow)
    np.testing.assert_allclose(record.acceleration[:, 0], np.cos(7 * TIME), atol=1e-12)


def test_a_filter_needs_every_sample(tmp_path):
    told = refusal(read, tmp_path, emptied("a1", np.arange(ROWS) == 50), decimate=2)
    assert told.startswith("data.decimate=2")
    jittered = TIME + 0.3 * STEP * np.random.default_rng(1).uniform(-1.0, 1.0, ROWS)
    assert "data.decimate=4: must be 1 where" in refusal(read, tmp_path, table(jittered), decimate=4)
    assert len(read(tmp_path, table(), decimate=2).time) == ROWS // 2


def test_a_nearly_empty_channel_is_told(tmp_path, caplog):
    there = np.arange(ROWS) < 30
    with caplog.at_level(logging.WARNING):
        read(tmp_path, emptied("a1", ~there))
    assert "data.acceleration.1 is nearly empty: 30 samples, 7.5 % of what its own rate would give" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        read(tmp_path, emptied("a1", np.arange(ROWS) % 20 > 0))  # slow, and complete
    assert "nearly empty" not in caplog.text


def test_a_channel_with_too_few_samples_or_one_value_is_refused(tmp_path):
    told = refusal(read, tmp_path, emptied("a1", np.arange(ROWS) >= 9))
    assert told.startswith("data.acceleration.1='a1'")
    assert "must be a column that varies" in refusal(read, tmp_path, table().assign(a1=3.0))
    constant = emptied("a1", np.arange(ROWS) % 2 == 0)
    constant["a1"] = constant["a1"].where(constant["a1"].isna(), 3.0)
    assert "a dead sensor?" in refusal(read, tmp_path, constant)
    assert read(tmp_path, table().assign(f=0.0)).calibrated == ()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time = 0.1 * np.arange(401)
    columns = {"t": time, "f": np.sin(time), "a1": np.cos(time), "a2": np.cos(2 * time)}
    pd.DataFrame(columns).to_csv("rig.csv", index=False)
    pd.DataFrame({"t": time[:101], "load": 1.0 + time[:101], "b1": np.sin(3 * time[:101])}).to_csv("b.csv", index=False)
    return tmp_path


def among(validation, *records):
    """The data that the system is tried on, and what the estimator is left of some records."""
    data = MeasuredData("rig.csv", force={1: "f"}, acceleration={1: "a1", 2: "a2"}, validation=validation)
    held = ValidationData.among([replace(data, **own) for own in records])
    return held, [each.measure(2).record for each in held.seen]


def tried(validation, **settings):
    held, seen = among(validation, settings)
    return seen[0], held.read(seen, 2)


def test_a_segment_is_taken_from_the_estimator(folder):
    seen, found = tried({"start": 30.0})
    assert seen.time[[0, -1]] == pytest.approx([0.0, 29.9])
    assert found.record.time[-1] == pytest.approx(40.0)
    assert found.record.time[found.first] == pytest.approx(30.0)
    # It begins where the estimate is well away from its end.
    assert found.record.time[0] == seen.time[found.begins]
    assert 28.0 < found.record.time[0] < 29.9
    np.testing.assert_allclose(found.record.acceleration[:, 0], np.cos(found.record.time))
    seen, found = tried({"stop": 10.0})  # the file's beginning
    assert seen.time[[0, -1]] == pytest.approx([10.1, 40.0])
    assert (found.begins, found.first) == (None, 0)
    assert found.record.time[[0, -1]] == pytest.approx([0.0, 10.0])
    seen, found = tried({"start": 30.0, "stop": 35.0, "settle": 1.0}, stop=20.0)  # what the user gives stays
    assert seen.time[-1] == pytest.approx(20.0)
    assert found.record.time[[found.first, -1]] == pytest.approx([31.0, 35.0])
    assert found.record.time[0] < 20.0  # the force in between is followed


@pytest.mark.parametrize(
    ("validation", "settings"),
    [
        ({"start": 10.0, "stop": 15.0}, {"start": 0.0, "stop": 20.0}),
        ({"start": 15.0}, {"stop": 20.0}),
        ({"decimate": 2}, {}),
    ],
)
def test_what_the_estimator_sees_is_no_validation(folder, validation, settings):
    with pytest.raises(InputError, match=r"data\.validation\.start.*outside of what the estimator sees"):
        tried(validation, **settings)


def test_another_record_begins_at_rest(folder):
    seen, found = tried({"path": "b.csv", "force": {1: "load"}, "acceleration": {2: "b1"}, "settle": 2.0}, holdout=[2])
    assert len(seen.time) == 401
    assert not seen.sensors("acceleration")[1]  # held out of the estimator, not of the validation
    assert found.begins is None
    assert found.record.time[found.first] == pytest.approx(2.0)
    assert found.record.sensors("acceleration").tolist() == [False, True]
    np.testing.assert_allclose(found.record.force[:, 0], 1.0 + found.record.time)


@pytest.mark.parametrize(
    ("validation", "setting", "allowed"),
    [
        ("b.csv", "data.validation", "a segment"),
        ({}, "data.validation", "a segment"),
        ({"pth": "b.csv"}, "data.validation.pth", "path"),
        ({"holdout": [1]}, "data.validation.holdout", "one of the settings"),
        ({"start": 30.0, "settle": -1.0}, "data.validation.settle", ">= 0"),
        ({"start": 30.0, "settle": 9.5}, "data.validation.settle", "leaving 16 samples"),
        ({"start": 39.9}, "data.validation.start, data.validation.stop", "at least 16 samples"),
        ({"path": "c.csv"}, "data.validation.path", "exist"),
        ({"path": "b.csv", "force": {1: "load"}}, "data.validation.acceleration.1", "column"),
        ({"path": "b.csv", "force": {1: None}, "acceleration": {1: "b1"}}, "data.validation", "forces are all"),
    ],
)
def test_what_is_refused(folder, validation, setting, allowed):
    with pytest.raises(InputError) as refused:
        tried(validation)
    assert refused.value.setting == setting
    assert allowed in str(refused.value)


def test_a_segment_of_the_file_of_one_of_several_records(folder):
    first = {"path": "b.csv", "force": {1: "load"}, "acceleration": {2: "b1"}}
    held, seen = among({"path": "rig.csv", "start": 30.0}, first, {})
    found = held.read(seen, 2)
    assert [record.time[-1] for record in seen] == pytest.approx([10.0, 29.9])
    assert found.of == 1
    assert found.record.time[0] == seen[1].time[found.begins]
    assert found.record.sensors("acceleration").tolist() == [True, True]  # the columns of the record whose file it is
    held, seen = among({"path": "c.csv", **{n: v for n, v in first.items() if n != "path"}}, {}, first)
    assert (held.of, held.follows, held.data.acceleration) == (0, False, {2: "b1"})


def test_a_segment_between_two_parts_of_one_file(folder):
    held, seen = among({"start": 12.0, "stop": 18.0}, {"start": 20.0}, {"stop": 5.0}, {"start": 6.0, "stop": 10.0})
    found = held.read(seen, 2)
    assert (found.of, found.begins is not None) == (2, True)  # the force from 10 s on is followed
    assert [record.time[0] for record in seen] == pytest.approx([20.0, 0.0, 6.0])
    with pytest.raises(InputError, match="outside of what the estimator sees"):
        among({"start": 12.0, "stop": 18.0}, {"start": 20.0}, {"start": 6.0, "stop": 15.0})
    with pytest.raises(InputError, match=r"data\.validation\.path=None: must be the file"):
        among({"start": 30.0}, {}, {"path": "b.csv"})
