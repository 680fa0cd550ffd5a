"""The ground's acceleration as a channel of a record: kept with it, read from a CSV file, refused where it is none."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from refusals import refusal

from pinn_cli.record.between_samples import held_by_lines
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Record
from pinn_cli.record.response import Repeats
from pinn_cli.settings.errors import InputError

STEP, ROWS = 0.02, 200
SETTINGS = {"path": "quake.csv", "time": "t", "acceleration": {3: "roof"}, "ground_acceleration": "ground"}


def table() -> pd.DataFrame:
    time = np.round(STEP * np.arange(ROWS), 2)
    return pd.DataFrame({"t": time, "ground": np.sin(3.0 * time), "roof": np.cos(time), "still": 0.0})


@pytest.fixture
def quake(tmp_path):
    table().to_csv(tmp_path / "quake.csv", index=False)
    return tmp_path


def read(base, **changes) -> Record:
    return MeasuredData(**{**SETTINGS, "base": base, **changes}).measure(3).record


def test_a_record_keeps_it_whatever_is_cut_away(quake):
    record = read(quake, frame="relative")
    np.testing.assert_allclose(record.ground_acceleration, table()["ground"], rtol=1e-12)
    for kept in (record.keep({"acceleration": [3]}), replace(record, unforced=record.unforced)):
        assert kept.ground_acceleration is record.ground_acceleration
        assert kept.frame == "relative"
    first = replace(record, repeats=Repeats(2, ROWS, {"ground_acceleration": np.array([4.0])})).until(50)
    np.testing.assert_array_equal(first.ground_acceleration, record.ground_acceleration[:50])
    assert first.frame == "relative"
    assert first.repeats.square["ground_acceleration"] == 1.0


@pytest.mark.parametrize(
    ("expected", "changes"),
    [
        ("data.ground_acceleration=3", {"ground_acceleration": 3}),
        ("data.ground_acceleration='base'", {"ground_acceleration": "base"}),
        ("data.ground_acceleration='roof'", {"ground_acceleration": "roof"}),
        ("data.ground_acceleration='still'", {"ground_acceleration": "still"}),
        ("data.frame=fixed", {"frame": "fixed"}),
        ("data.frame=relative", {"frame": "relative", "ground_acceleration": None}),
        ("data.intersample=zero_order_hold", {"intersample": "zero_order_hold"}),
    ],
)
def test_a_setting_that_cannot_be_used(quake, expected, changes):
    assert refusal(read, quake, **changes).startswith(expected)


def test_a_sample_of_the_ground_may_be_missing(tmp_path):
    values = table()
    values.loc[7, "ground"] = np.nan
    values.to_csv(tmp_path / "quake.csv", index=False)
    (channel,) = read(tmp_path).calibrated
    assert channel.quantity == "ground_acceleration"
    np.testing.assert_array_equal(channel.measured, values["ground"].dropna())
    with pytest.raises(InputError, match=r"data\.intersample=first_order_hold"):  # lines have no gaps
        read(tmp_path, intersample="first_order_hold")


@pytest.mark.parametrize(
    ("match", "changes"),
    [
        ("ground_acceleration must be", {"ground_acceleration": np.zeros(ROWS - 1)}),
        ("ground_acceleration must be", {"ground_acceleration": np.r_[np.nan, np.zeros(ROWS - 1)]}),
        ("data.frame=fixed", {"frame": "fixed"}),
        ("data.intersample", {"intersample": "zero_order_hold"}),
    ],
)
def test_a_record_refuses_contradictions(quake, match, changes):
    with pytest.raises(ValueError, match=match):
        replace(read(quake), **changes)


def test_straight_lines_between_its_samples_are_taken_out(tmp_path, caplog):
    rng = np.random.default_rng(0)
    time = np.arange(1001) * STEP
    lines = np.interp(time, time[::2], rng.standard_normal(501))
    pd.DataFrame({"t": time, "ground": lines, "roof": np.cos(time)}).to_csv(tmp_path / "quake.csv", index=False)
    found, asked, left = read(tmp_path), read(tmp_path, intersample="first_order_hold"), {"intersample": "band_limited"}
    assert "data.ground_acceleration lies on straight lines" in caplog.text
    np.testing.assert_array_equal(found.ground_acceleration, asked.ground_acceleration)
    np.testing.assert_allclose(found.ground_acceleration, held_by_lines(lines), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(read(tmp_path, **left).ground_acceleration, lines)
    np.testing.assert_array_equal(found.acceleration[:, 2], np.cos(time))
    assert not found.assumed


def test_nobody_says_what_it_does_between_its_samples(quake):
    assert read(quake).assumed
    assert not read(quake, intersample="band_limited").assumed
