"""Sensors with a gain, an offset, a drift and a delay: what they show, and what of it is unknown."""

import numpy as np
import pytest

from pinn_cli.record.channel import CALIBRATED, Calibration, Channel, unknown_calibration
from pinn_cli.record.record import Record

TIME = 2.0 + 0.01 * np.arange(400)
UNKNOWN = Calibration(1.0, 10.0, unknown=True)


def motion(time: np.ndarray) -> np.ndarray:
    return np.sin(3.0 * time)


def shown(gain: float, offset: float, drift: float, delay: float) -> Channel:
    """y(t) = gain x(t - delay) + offset + drift (t - start)."""
    values = gain * motion(TIME - delay) + offset + drift * (TIME - TIME[0])
    numbers = {"gain": gain, "offset": offset, "drift": drift, "delay": delay}
    return Channel("a1", "acceleration", {0: 1.0}, TIME, values, {k: Calibration(v) for k, v in numbers.items()})


def test_what_is_known_is_taken_out():
    channel = shown(1.3, -0.4, 0.2, 0.05)
    at, felt = channel.corrected_samples()
    np.testing.assert_allclose(at, TIME - 0.05)
    np.testing.assert_allclose(felt, motion(at), atol=1e-12)
    inside = TIME[TIME[-1] - 0.06 > TIME]
    np.testing.assert_allclose(channel.history(inside), motion(inside), atol=2e-4)


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
    channel = Channel("x", quantity, weights, TIME, motion(TIME), fills=fills)
    assert channel.feels_one == feels_one
    assert channel.is_column == (column is not None)
    assert channel.place == (CALIBRATED if column is None else quantity, column or 0)


def test_where_offset_and_drift_are_unknown_a_straight_line_says_where_they_start():
    values = 5.0 + 3.0 * (TIME - TIME[0])
    offset, drift = (unknown_calibration(kind, TIME, values, both=True) for kind in ("offset", "drift"))
    assert (offset.value, drift.value) == (pytest.approx(5.0), pytest.approx(3.0))


def test_a_search_may_start_elsewhere_where_a_number_is_unknown_and_nowhere_else():
    numbers = {"gain": UNKNOWN, "delay": Calibration(0.0, 0.01)}
    channel = Channel("a1", "acceleration", {0: 1.0}, TIME, motion(TIME), numbers)
    nothing = np.full((400, 2), np.nan)
    acceleration = nothing.copy()
    acceleration[:, 0] = channel.history(TIME)
    still = np.zeros((400, 2))
    record = Record(TIME, nothing, nothing, acceleration, still, np.array([True, True]), calibrated=(channel,))
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


def test_between_uneven_samples_there_are_straight_lines():
    time = np.delete(0.01 * np.arange(50), range(20, 30))
    channel = Channel("a", "acceleration", {0: 1.0}, time, time**2)
    assert channel.even_step is None
    np.testing.assert_allclose(channel.history(np.array([0.245])), np.interp(0.245, time, time**2))


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
    # All of them where none is missing, however few.
    np.testing.assert_array_equal(run(np.arange(1000) < 20)[0], values[:20])


def test_samples_of_a_clock_since_1970_are_even_up_to_its_rounding():
    """A double tells times of today to 2.4e-7 s, which is 5 % of a step at 200 kHz."""
    time = 1.7e9 + 5e-6 * np.arange(1000)
    run, step = Channel("a1", "acceleration", {0: 1.0}, time, motion(time)).even_run
    assert len(run) == 1000
    assert step == pytest.approx(5e-6, rel=1e-3)
