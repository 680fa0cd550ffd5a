"""Spectra of channels that miss samples, and stiffnesses that are screened with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from independent_records import frame_record

from pinn_cli.record.gauge import Calibration, Gauge
from pinn_cli.record.record import Record
from pinn_cli.scheme.cross_spectra import CrossSpectra
from pinn_cli.scheme.lagged_products import Samples, cross_spectrum, misses_samples
from pinn_cli.scheme.screening import screened

COUNT, STEP = 256, 0.01
TIME = 3.0 + STEP * np.arange(COUNT)
STRETCH = np.eye(3) - np.eye(3, k=-1)


def record_of(column: np.ndarray, *gauges: Gauge) -> Record:
    nothing = np.full((COUNT, 1), np.nan)
    return Record(TIME, nothing, nothing, column[:, None], np.zeros((COUNT, 1)), np.array([True]), gauges=gauges)


def gauge_at(time: np.ndarray, values: np.ndarray, **calibration: Calibration) -> Gauge:
    return Gauge("a1", "acceleration", {0: 1.0}, time, values, calibration)


def test_complete_channels_have_the_products_of_their_spectra():
    a, b = np.random.default_rng(0).standard_normal((2, COUNT))
    found = cross_spectrum(Samples.of_column(a), Samples.of_column(b))
    window = np.hanning(COUNT)
    spectra = [np.fft.rfft((x - x.mean()) * window) for x in (a, b)]
    np.testing.assert_allclose(found, spectra[0] * spectra[1].conj(), atol=1e-9 * np.abs(found).max())


def test_samples_between_the_records_times_have_the_phases_of_their_own():
    rng = np.random.default_rng(1)
    at = TIME + STEP * rng.uniform(-0.5, 0.5, COUNT)
    gauge = gauge_at(at, rng.standard_normal(COUNT))
    found = Samples.of_gauge(gauge, record_of(gauge.values, gauge))
    place = np.rint((at - TIME[0]) / STEP).astype(int)
    inside = (place >= 0) & (place < COUNT)
    at, felt, weight = at[inside], gauge.values[inside], np.hanning(COUNT)[place[inside]]
    swing = weight * (felt - np.average(felt, weights=weight))
    phase = -1j * np.pi * np.arange(COUNT + 1)[:, None] / COUNT * (at - TIME[0]) / STEP
    np.testing.assert_allclose(found.values, np.exp(phase) @ swing, atol=1e-5 * np.abs(found.values).max())


@pytest.mark.parametrize("missing", ["half at random", "four of five", "a gap"])
def test_what_is_missing_scatters_and_does_not_shift(missing):
    """Averaged over white records the cross spectrum of a channel and its echo is that of the whole channel."""
    rng, late = np.random.default_rng(2), 3
    power = float(np.sum(np.hanning(COUNT) ** 2))
    total, rounds = 0.0, 400
    for _ in range(rounds):
        force = rng.standard_normal(COUNT + late)
        echo, force = force[:COUNT], force[late:]
        there = {
            "half at random": rng.random(COUNT) < 0.5,
            "four of five": np.arange(COUNT) % 5 == 2,
            "a gap": np.abs(np.arange(COUNT) - 100) > 25,
        }[missing]
        gauge = gauge_at(TIME[there], echo[there])
        assert misses_samples(gauge, record_of(echo, gauge))
        total = total + cross_spectrum(Samples.of_gauge(gauge, record_of(echo, gauge)), Samples.of_column(force))
    turned = total * np.exp(2j * np.pi * np.fft.rfftfreq(COUNT) * late) / rounds / power
    assert np.abs(np.mean(turned[4:-4]) - 1.0) < 0.05
    assert np.std(turned[4:-4]) < 0.2


def lost(record: Record, seed: int = 0) -> Record:
    """Half of the first sensor's samples, four of five of the second's and a fifth of the third's in one piece."""
    rng, count = np.random.default_rng(seed), len(record.time)
    there = np.ones((count, 3), bool)
    there[:, 0] = rng.random(count) < 0.5
    there[:, 1] = np.arange(count) % 5 == 0
    there[int(0.5 * count) : int(0.7 * count), 2] = False
    gauges = tuple(
        Gauge(f"a{i + 1}", "acceleration", {i: 1.0}, record.time[there[:, i]], record.acceleration[there[:, i], i])
        for i in range(3)
    )
    columns = np.stack([gauge.history(record.time) for gauge in gauges], axis=1)
    return replace(record, acceleration=columns, gauges=gauges)


@pytest.fixture(scope="module")
def made():
    return frame_record(rate=100.0, duration=20.0, cubic=False)


def best_of(record: Record, made) -> np.ndarray:
    known = {"m": made.structure.m, "c": made.structure.c, "k": np.full(3, np.nan)}
    guess = {"m": made.structure.m, "k": np.full(3, 2e5)}
    return screened(record, STRETCH, known, guess)[0].parameters["k"] / made.structure.k


def test_stiffnesses_are_found_from_the_samples_that_are_there(made):
    assert np.abs(best_of(lost(made.record), made) - 1.0).max() < 0.1
    # Straight lines through what is missing lead astray.
    assert np.abs(best_of(replace(lost(made.record), gauges=()), made) - 1.0).max() > 0.5


def test_a_load_cell_that_misses_samples_tells_stiffnesses_too(made):
    record = made.record
    there = np.random.default_rng(3).random(len(record.time)) < 0.6
    cell = Gauge("f", "force", {2: 1.0}, record.time[there], record.force[there, 2])
    force = record.force.copy()
    force[:, 2] = cell.history(record.time)
    assert np.abs(best_of(replace(record, force=force, gauges=(cell,)), made) - 1.0).max() < 0.05


def test_a_channel_that_misses_none_has_the_spectra_of_its_column(made):
    """A delay that is known moves its samples off the record's times and loses none."""
    record = made.record
    late = Gauge(
        "a1",
        "acceleration",
        {0: 1.0},
        record.time,
        record.acceleration[:, 0],
        {"delay": Calibration(2.3 * record.step)},
    )
    assert not misses_samples(late, record)
    column = record.acceleration.copy()
    column[:, 0] = late.history(record.time)
    with_gauge, without = (
        CrossSpectra.of(replace(record, acceleration=column, gauges=gauges)) for gauges in ((late,), ())
    )
    np.testing.assert_array_equal(with_gauge.of_both, without.of_both)
    assert with_gauge.scatter is None
