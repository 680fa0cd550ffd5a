"""Records with gaps, several rates and jitter: what becomes a column, what is calibrated, and what is told."""

import logging
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from refusals import refusal

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Record

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


def test_what_is_held_out_at_uneven_times_scores_nothing(tmp_path):
    time = TIME + 0.4 * STEP * np.random.default_rng(1).uniform(-1.0, 1.0, ROWS)
    told = refusal(read, tmp_path, table(time), holdout=[2])
    assert told.startswith("data.holdout=[2]")
