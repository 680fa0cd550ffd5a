"""Records, their ground's acceleration, and channels with a gain, an offset, a drift and a delay."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from calls import refusal

from pinn_cli.record.between_samples import held_by_lines
from pinn_cli.record.channel import CALIBRATED, Calibration, Channel, unknown_calibration
from pinn_cli.record.channels import channels
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Record
from pinn_cli.record.response import Repeats
from pinn_cli.settings.errors import InputError

TIME = np.linspace(1.0, 3.0, 41)


def columns(*sensors: int) -> np.ndarray:
    values = np.full((41, 3), np.nan)
    for dof in sensors:
        values[:, dof - 1] = float(dof)
    return values


def record(**changes) -> Record:
    settings = {
        "time": TIME,
        "displacement": columns(),
        "velocity": columns(2),
        "acceleration": columns(1, 2),
        "force": np.nan_to_num(columns(1)),
        "unforced": [False, True, True],
        **changes,
    }
    return Record(**settings)


def test_an_unknown_force_is_no_sensor_and_a_known_zero_is_none_either():
    it = record(force=columns(3), unforced=[False, False, False])
    assert it.sensors("force").tolist() == [False, False, True]
    assert record(time=1.7e9 + 0.001 * np.arange(41)).step == pytest.approx(0.001, rel=1e-4)  # a clock since 1970


def test_keep_blanks_every_other_response_sensor():
    kept = record().keep({"acceleration": [2, 3]})
    assert kept.sensors("acceleration").tolist() == [False, True, False]
    assert kept.sensors("velocity").tolist() == [False, False, False]
    assert kept.sensors("force").tolist() == [True, False, False]
    assert kept.observed.tolist() == [False, True, False]
    assert record().observed.tolist() == [True, True, False]


def test_keep_leaves_something_and_knows_what_there_is():
    with pytest.raises(InputError, match="no response sensor"):
        record().keep({"velocity": [1]})
    with pytest.raises(ValueError, match="force"):
        record().keep({"force": [1]})
    with pytest.raises(ValueError, match="DOF 4"):
        record().keep({"velocity": [4]})


def test_other_histories_of_channels_take_the_place_of_theirs_and_of_no_others():
    moving = {"support_velocity": np.full((41, 2), 4.0)}
    it = record(ground_acceleration=0.5 * TIME, supports=moving, support_names=("wall", "table"))
    every = channels(it, ("acceleration", "ground_acceleration", "support_velocity"))
    assert [channel.where for channel in every] == ["1", "2", "wall", "table", "0"]
    shown = it.showing(replace(every[i], measured=-every[i].measured) for i in (1, 3, 4))
    np.testing.assert_array_equal(shown.acceleration[0, :2], [1.0, -2.0])
    np.testing.assert_array_equal(shown.supports["support_velocity"][0], [4.0, -4.0])
    np.testing.assert_array_equal(shown.ground_acceleration, -0.5 * TIME)
    np.testing.assert_array_equal(shown.velocity, it.velocity)
    assert (it.acceleration[0, 1], it.supports["support_velocity"][0, 1]) == (2.0, 4.0)


def half_filled() -> np.ndarray:
    values = columns(1)
    values[3, 0] = np.nan
    return values


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("time", {"time": TIME[:10], "velocity": columns(2)[:10]}),
        ("step", {"time": np.append(TIME[:-1], 3.01)}),
        ("grow", {"time": TIME[::-1]}),
        ("velocity has shape", {"velocity": columns(2)[:, :2]}),
        ("acceleration must be finite throughout", {"acceleration": half_filled()}),
        ("unforced DOF must be 0", {"force": columns(1, 2, 3)}),
        ("intersample", {"intersample": "linear"}),
        ("no response sensor", {"velocity": columns(), "acceleration": columns()}),
        ("ground_acceleration must be", {"ground_acceleration": np.zeros(40)}),
        ("ground_acceleration must be", {"ground_acceleration": np.r_[np.nan, np.zeros(40)]}),
        ("data.frame=fixed", {"frame": "fixed"}),
        ("data.intersample", {"ground_acceleration": TIME, "intersample": "zero_order_hold"}),
    ],
)
def test_contradictions_are_refused(what, changes):
    with pytest.raises(ValueError, match=what):
        record(**changes)


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
    pd.DataFrame({"t": time, "ground": np.sin(time), "roof": np.cos(time)}).to_csv(tmp_path / "quake.csv", index=False)
    assert (found.assumed, read(tmp_path).assumed, read(tmp_path, **left).assumed) == (False, True, False)


CLOCK = 2.0 + 0.01 * np.arange(400)
UNKNOWN = Calibration(1.0, 10.0, unknown=True)


def motion(time: np.ndarray) -> np.ndarray:
    return np.sin(3.0 * time)


def shown(gain: float, offset: float, drift: float, delay: float) -> Channel:
    """y(t) = gain x(t - delay) + offset + drift (t - start)."""
    values = gain * motion(CLOCK - delay) + offset + drift * (CLOCK - CLOCK[0])
    numbers = {"gain": gain, "offset": offset, "drift": drift, "delay": delay}
    return Channel("a1", "acceleration", {0: 1.0}, CLOCK, values, {k: Calibration(v) for k, v in numbers.items()})


def test_what_is_known_is_taken_out():
    channel = shown(1.3, -0.4, 0.2, 0.05)
    at, felt = channel.corrected_samples()
    np.testing.assert_allclose(at, CLOCK - 0.05)
    np.testing.assert_allclose(felt, motion(at), atol=1e-12)
    inside = CLOCK[CLOCK[-1] - 0.06 > CLOCK]
    np.testing.assert_allclose(channel.history(inside), motion(inside), atol=2e-4)
    line = 5.0 + 3.0 * (CLOCK - CLOCK[0])
    offset, drift = (unknown_calibration(kind, CLOCK, line, both=True) for kind in ("offset", "drift"))
    assert (offset.value, drift.value) == (pytest.approx(5.0), pytest.approx(3.0))


@pytest.mark.parametrize(
    ("quantity", "weights", "fills", "column", "feels_one"),
    [
        ("acceleration", {2: 1.0}, True, 2, True),
        ("acceleration", {2: 1.0}, False, None, True),
        ("displacement", {2: -1.0}, True, None, True),
        ("displacement", {2: 1.0, 1: -1.0}, True, None, False),
        ("ground_acceleration", {}, True, 0, True),
        ("connection_force", {}, True, None, False),
        ("force", {1: 1.0}, True, 1, True),
    ],
)
def test_what_it_feels(quantity, weights, fills, column, feels_one):
    channel = Channel("x", quantity, weights, CLOCK, motion(CLOCK), fills=fills)
    assert channel.feels_one == feels_one
    assert channel.is_column == (column is not None)
    assert channel.place == (CALIBRATED if column is None else quantity, column or 0)


def test_a_search_may_start_elsewhere_where_a_number_is_unknown_and_nowhere_else():
    numbers = {"gain": UNKNOWN, "delay": Calibration(0.0, 0.01)}
    channel = Channel("a1", "acceleration", {0: 1.0}, CLOCK, motion(CLOCK), numbers)
    nothing = np.full((400, 2), np.nan)
    acceleration = nothing.copy()
    acceleration[:, 0] = channel.history(CLOCK)
    still = np.zeros((400, 2))
    record = Record(CLOCK, nothing, nothing, acceleration, still, np.array([True, True]), calibrated=(channel,))
    again = record.started_at({"a1": {"gain": 2.0, "delay": 0.03}})
    (moved,) = again.calibrated
    assert (moved.number("gain").value, moved.number("gain").std, moved.number("delay").value) == (2.0, 10.0, 0.0)
    np.testing.assert_allclose(again.acceleration[:, 0], acceleration[:, 0] / 2.0)
    np.testing.assert_array_equal(record.acceleration, acceleration)


@pytest.mark.parametrize("delay", [0.0, 0.025, -0.013])
def test_a_late_sensor_shows_what_it_felt_between_its_samples(delay):
    time = 0.01 * np.arange(400)
    felt = np.sin(2.0 * np.pi * 12.0 * time)
    late = np.sin(2.0 * np.pi * 12.0 * (time - delay))
    channel = Channel("a", "acceleration", {0: 1.0}, time, late, {"delay": Calibration(delay)})
    shown = channel.history(time)
    np.testing.assert_allclose(shown[10:-10], felt[10:-10], atol=2e-3)


def test_the_longest_even_run_stands_for_a_channel_with_gaps():
    time = 2.0 + 0.01 * np.arange(1000)
    values = np.arange(1000.0)

    def run(there: np.ndarray) -> tuple[np.ndarray, float] | None:
        return Channel("a1", "acceleration", {0: 1.0}, time[there], values[there]).even_run

    gap = (np.arange(1000) < 300) | (np.arange(1000) >= 600)
    found, step = run(gap)
    np.testing.assert_array_equal(found, values[600:])
    assert step == pytest.approx(0.01)
    assert run(np.random.default_rng(0).random(1000) < 0.5) is None
    uneven = Channel("a", "acceleration", {0: 1.0}, time[gap], values[gap])
    assert uneven.even_step is None
    np.testing.assert_allclose(uneven.history(np.array([6.5])), 450.0)  # along a straight line
    # A double tells times of today to 2.4e-7 s, which is 5 % of a step at 200 kHz.
    since_1970 = Channel("a", "acceleration", {0: 1.0}, 1.7e9 + 5e-6 * np.arange(1000), values).even_run
    assert (len(since_1970[0]), since_1970[1]) == (1000, pytest.approx(5e-6, rel=1e-3))
    # All of them where none is missing, however few.
    np.testing.assert_array_equal(run(np.arange(1000) < 20)[0], values[:20])
