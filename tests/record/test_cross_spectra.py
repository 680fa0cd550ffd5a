"""Cross spectra against scipy's, and of channels that miss samples against exact values."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import csd
from scipy.signal.windows import tukey

from pinn_cli.record.channel import Calibration, Channel
from pinn_cli.record.channels import channels
from pinn_cli.record.cross_spectra import CrossSpectra, Samples, cross_spectrum, independent_part, misses_samples, taper
from pinn_cli.record.record import Record

COUNT, STEP = 256, 0.01
TIME = 3.0 + STEP * np.arange(COUNT)


def record_of(column: np.ndarray, *calibrated: Channel) -> Record:
    nothing = np.full((COUNT, 1), np.nan)
    return Record(
        TIME, nothing, nothing, column[:, None], np.zeros((COUNT, 1)), np.array([True]), calibrated=calibrated
    )


def channel_at(time: np.ndarray, values: np.ndarray, **calibration: Calibration) -> Channel:
    return Channel("a1", "acceleration", {0: 1.0}, time, values, calibration)


@dataclass(frozen=True)
class Sensor:
    order: int = 2


def test_averages_over_pieces_are_scipys():
    values = np.random.default_rng(0).standard_normal((20_000, 4)) + np.array([1.0, 0.0, -3.0, 0.0])
    values[3:, 1] += values[:-3, 2]
    found = CrossSpectra.of_pieces([Sensor(), Sensor(0)], [Sensor(), Sensor()], values, STEP)
    length = 2 * (len(found.frequency) - 1)
    options = {"fs": 1.0, "window": np.hanning(length), "nperseg": length, "return_onesided": False}
    for i in range(4):
        for j in range(4):
            _, expected = csd(values[:, j], values[:, i], detrend="constant", **options)
            np.testing.assert_allclose(found.cross[:-1, i, j], expected[: length // 2], atol=1e-12)
    np.testing.assert_allclose(found.frequency, np.fft.rfftfreq(length, STEP))
    np.testing.assert_array_equal(found.power, np.einsum("bcc->bc", found.cross).real)
    np.testing.assert_allclose(found.power.mean(0), [1.0, 2.0, 1.0, 1.0], rtol=0.05)
    np.testing.assert_allclose(found.differentiation[:, 1], 1.0)
    np.testing.assert_allclose(found.differentiation[:, 0], -((2.0 * np.pi * found.frequency) ** 2))


def test_responses_are_those_of_least_squares():
    values = np.random.default_rng(1).standard_normal((40_000, 3))
    values[:, 0] += 2.0 * values[:, 1] - 5.0 * values[:, 2]
    found = CrossSpectra.of_pieces([Sensor()], [Sensor(), Sensor()], values, STEP)
    assert np.abs(found.response[:, 0] - [2.0, -5.0]).max() < 1.0
    np.testing.assert_allclose(found.response[:, 0].mean(0), [2.0, -5.0], atol=0.05)
    assert np.mean(found.coherence) == pytest.approx(29.0 / 30.0, abs=0.01)


@pytest.mark.parametrize("part", [1.0, 0.1])
def test_averages_over_bands_are_scipys(part):
    rng, nothing = np.random.default_rng(2), np.full((COUNT, 2), np.nan)
    record = Record(TIME, nothing, nothing, rng.standard_normal((COUNT, 2)), rng.standard_normal((COUNT, 2)),
                    np.zeros(2, bool))  # fmt: skip
    sensors, loads, edges = channels(record), channels(record, ("force",)), [3, 4, 9, 20]
    found = CrossSpectra.of_bands(record, sensors, loads[:1], edges, tapered=part)
    assert found.cross.shape == (3, 3, 1)
    window = tukey(COUNT, part)
    lines = csd(record.force[:, 0], record.acceleration[:, 1], fs=1.0, window=window, nperseg=COUNT,
                detrend="constant", return_onesided=False)[1]  # fmt: skip
    expected = [lines[low:high].mean() for low, high in pairwise(edges)]
    np.testing.assert_allclose(found.of_both[:, 1, 0], expected, rtol=1e-9)
    whole = CrossSpectra.of_bands(record, sensors, loads, edges, 4, part)
    np.testing.assert_allclose(whole.cross[:, :3, 2], found.cross[..., 0], rtol=1e-12)
    np.testing.assert_allclose(whole.power, np.einsum("bcc->bc", whole.cross).real, rtol=1e-12)


def test_counts_tell_how_averages_scatter():
    rng, window = np.random.default_rng(3), taper(400)
    lines = np.fft.rfft(rng.standard_normal((4000, 400)) * window)[:, 20:120] / np.sqrt(np.sum(window**2))
    means = np.mean(np.abs(lines) ** 2, axis=1)
    assert np.var(means) * 100.0 * independent_part(window) == pytest.approx(1.0, rel=0.1)


def test_samples_that_are_there_give_the_sums_over_their_pairs():
    """Against sums over all pairs, lag by lag, which nothing but a pair that is there enters."""
    rng, nothing = np.random.default_rng(4), np.full((COUNT, 1), np.nan)
    a, f, there = *rng.standard_normal((2, COUNT)), rng.random(COUNT) < 0.7
    channel = channel_at(TIME[there], a[there])
    record = Record(TIME, nothing, nothing, a[:, None], f[:, None], np.zeros(1, bool), calibrated=(channel,))
    edges = list(range(10, 14))
    found = CrossSpectra.of_bands(record, channels(record), channels(record, ("force",)), edges)
    window, lags = np.hanning(COUNT), np.arange(1 - COUNT, COUNT)
    swing = np.where(there, window * (a - np.average(a[there], weights=window[there])), 0.0)
    products, pairs, every = (
        np.correlate(x, y, "full")
        for x, y in ((swing, window * (f - f.mean())), (window * there, window), (window, window))
    )
    seen = pairs > 0.01 * every + 1e-9 * every[COUNT - 1]
    scaled = np.where(seen, products * every / np.where(seen, pairs, 1.0), 0.0)
    lines = np.exp(-2j * np.pi * np.outer(edges[:-1], lags) / COUNT) @ scaled / np.sum(window**2)
    np.testing.assert_allclose(found.of_both[:, 0, 0], lines, rtol=1e-9)


def test_samples_between_the_records_times_have_the_phases_of_their_own():
    rng = np.random.default_rng(1)
    at = TIME + STEP * rng.uniform(-0.5, 0.5, COUNT)
    channel = channel_at(at, rng.standard_normal(COUNT))
    found = Samples.at_own_times(channel, record_of(channel.measured, channel), np.hanning(COUNT))
    place = np.rint((at - TIME[0]) / STEP).astype(int)
    inside = (place >= 0) & (place < COUNT)
    at, felt, weight = at[inside], channel.measured[inside], np.hanning(COUNT)[place[inside]]
    swing = weight * (felt - np.average(felt, weights=weight))
    phase = -1j * np.pi * np.arange(COUNT + 1)[:, None] / COUNT * (at - TIME[0]) / STEP
    np.testing.assert_allclose(found.values, np.exp(phase) @ swing, atol=1e-5 * np.abs(found.values).max())


@pytest.mark.parametrize("missing", ["half at random", "four of five", "a gap"])
def test_what_is_missing_scatters_and_does_not_shift(missing):
    """Averaged over white records the cross spectrum of a channel and its echo is that of the whole channel."""
    rng, late = np.random.default_rng(2), 3
    window, total, rounds = np.hanning(COUNT), 0.0, 400
    for _ in range(rounds):
        force = rng.standard_normal(COUNT + late)
        echo, force = force[:COUNT], force[late:]
        there = {
            "half at random": rng.random(COUNT) < 0.5,
            "four of five": np.arange(COUNT) % 5 == 2,
            "a gap": np.abs(np.arange(COUNT) - 100) > 25,
        }[missing]
        channel = channel_at(TIME[there], echo[there])
        assert misses_samples(channel, record_of(echo, channel))
        seen = Samples.at_own_times(channel, record_of(echo, channel), window)
        total = total + cross_spectrum(seen, Samples.of_column(force, window)) / rounds
    turned = total * np.exp(2j * np.pi * np.fft.rfftfreq(COUNT) * late)
    assert np.abs(np.mean(turned[4:-4]) - 1.0) < 0.05
    assert np.std(turned[4:-4]) < 0.2


def test_a_channel_that_misses_none_has_the_spectra_of_its_column():
    """A delay that is known moves its samples off the record's times and loses none."""
    column = np.random.default_rng(5).standard_normal(COUNT)
    late = channel_at(TIME, column, delay=Calibration(2.3 * STEP))
    record = record_of(late.history(TIME), late)
    assert not misses_samples(late, record)
    with_channel, without = (
        CrossSpectra.of_bands(each, channels(each), [], [2, 5, 9], 1)
        for each in (record, replace(record, calibrated=()))
    )
    np.testing.assert_array_equal(with_channel.cross, without.cross)
