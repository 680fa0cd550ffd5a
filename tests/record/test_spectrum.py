"""A channel's band and white noise, read off its periodogram."""

from __future__ import annotations

import numpy as np
import pytest
from small_problems import accelerations, measured, small_chain

from pinn_cli.record.channels import record_band
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.spectrum import (
    band_share,
    lowest_level,
    occupied_band,
    periodogram,
    reaches_nyquist,
    signal_band,
    signal_edges,
    visible_floor,
    white_level,
)

DURATION, SAMPLES = 40.0, 2049
STEP = DURATION / (SAMPLES - 1)
TIME = np.linspace(0.0, DURATION, SAMPLES)


def banded(low: float, high: float, dofs: int = 1) -> np.ndarray:
    """(N, dofs) of rms 1."""
    return BandedNoise(dofs, DURATION, SAMPLES, [low, high], 1.0, list(range(1, dofs + 1)), seed=3).signals(TIME)


def white(std: float, columns: int = 1, seed: int = 0) -> np.ndarray:
    return std * np.random.default_rng(seed).normal(size=(SAMPLES, columns))


def test_the_periodogram_of_white_noise_is_its_variance():
    frequency, power = periodogram(white(3.0)[:, 0], STEP)
    assert frequency[-1] == pytest.approx(0.5 / STEP, rel=1e-3)
    assert power[2:-2].mean() == pytest.approx(9.0, rel=0.1)


@pytest.mark.parametrize("noise", [1e-3, 0.03, 0.3])
@pytest.mark.parametrize("top", [1.0, 4.0])
def test_signal_band(top, noise):
    x = banded(0.1, top)[:, 0] + white(noise)[:, 0]
    # A Hann window widens a line by two bins.
    assert signal_band(x, STEP) == pytest.approx(top, abs=0.1 * top + 4.0 / DURATION)


@pytest.mark.parametrize(("low", "top"), [(0.5, 4.0), (2.0, 8.0)])
def test_a_signal_stands_out_between_its_edges_and_has_its_power_there(low, top):
    x = banded(low, top)[:, 0] + white(0.1)[:, 0]
    found = signal_edges(x, STEP)
    assert found == pytest.approx((low, top), abs=0.1 * top)
    assert 0.97 < band_share(x, STEP, *found) < 1.0
    assert band_share(x, STEP, 0.0, 0.5 / STEP) == pytest.approx(1.0)


def test_nothing_stands_out_of_a_constant():
    assert np.isnan(signal_edges(np.ones(SAMPLES), STEP)).all()
    assert band_share(np.ones(SAMPLES), STEP, np.nan, np.nan) == 0.0


@pytest.mark.parametrize("samples", [129, *(pytest.param(count, marks=pytest.mark.slow) for count in (257, 513))])
def test_the_noise_of_a_short_channel_does_not_pass_for_signal(samples):
    rng, taken_in = np.random.default_rng(0), 0
    for _ in range(1000):
        phase = 2.0 * np.pi * (np.outer([0.02, 0.05, 0.08], np.arange(samples)) + rng.uniform(size=(3, 1)))
        taken_in += signal_band(10.0 * np.sin(phase).sum(axis=0) + rng.normal(size=samples), 1.0) > 0.2
    assert taken_in <= 3  # with two floors throughout it is 34 where there are 129


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_a_signal_that_reaches_where_the_floor_is_read_is_kept(noise):
    band = 0.5 / STEP  # up to Nyquist; a third of the bins of the upper half hold signal
    x = banded(0.1, 0.55 * band)[:, 0] + white(noise)[:, 0]
    assert signal_band(x, STEP) == pytest.approx(0.55 * band, rel=0.03)


@pytest.fixture(scope="module")
def record():
    return measured(small_chain(), snr_db=40.0, duration=24.0, samples=769).record


def test_the_band_of_a_record_is_that_of_its_widest_channel(record):
    seen = accelerations(record)
    channels = [seen.force[:, 0], seen.acceleration[:, 0], seen.acceleration[:, 1]]
    assert record_band(seen) == max(signal_band(x, seen.step) for x in channels)
    assert record_band(seen) >= 0.9 * 15.0 / 24.0  # what the excitation reaches


def test_white_level_looks_only_above_the_signal():
    x = banded(0.1, 4.0)[:, 0] + white(0.01)[:, 0]
    assert white_level(x, STEP, 5.0) == pytest.approx(0.01, rel=0.1)


def test_white_level_is_not_fooled_by_an_anti_alias_filter():
    frequency = np.fft.rfftfreq(SAMPLES, STEP)
    spectrum = np.fft.rfft(white(0.2)[:, 0]) * (frequency < 0.85 * frequency[-1])
    assert white_level(np.fft.irfft(spectrum, SAMPLES), STEP, 5.0) == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize(
    ("histories", "share"),
    [(white(1.0, 4), 0.93), (banded(1.0, 1.5, 3), 0.08), (banded(0.05, 5.0, 4), 0.5)],
    ids=["white", "narrow", "half"],
)
def test_histories_fill_the_share_that_they_occupy(histories, share):
    assert occupied_band(histories, STEP, 10.0) == pytest.approx(share, abs=0.12)


@pytest.mark.parametrize(("histories", "top"), [
    (np.zeros((100, 2)), 10.0), (white(1.0), 0.0), (np.empty((SAMPLES, 0)), 10.0), (white(1.0)[:5], 10.0),
], ids=["silence", "no band", "every force is unknown", "a spline of a handful of intervals"])  # fmt: skip
def test_what_says_nothing_of_a_band_fills_it(histories, top):
    assert occupied_band(histories, STEP, top) == 1.0


@pytest.mark.parametrize("low", [0.1, 6.0])
def test_the_lowest_level_is_found_beside_a_signal_wherever_that_lies(low):
    """A record whose content reaches the Nyquist frequency shows its noise below its band."""
    nyquist = 0.5 / STEP
    for high in (0.3 * nyquist, 0.99 * nyquist):
        x = banded(low, high)[:, 0] + white(0.01)[:, 0]
        if low < 1.0 and high > 0.9 * nyquist:
            assert lowest_level(x, STEP) > 0.1  # nothing but signal: an upper bound
        else:
            assert lowest_level(x, STEP) == pytest.approx(0.01, rel=0.3)


@pytest.mark.parametrize("noise", [1e-3, 0.03, 0.3])
def test_the_visible_floor_is_the_noise_above_the_band(noise):
    found = [visible_floor(banded(0.1, 8.0)[:, 0] + white(noise, seed=seed)[:, 0], STEP) for seed in range(10)]
    np.testing.assert_allclose(found, noise, rtol=0.15)


def test_there_is_no_visible_floor_where_the_signal_reaches_the_nyquist_frequency():
    x = banded(0.1, 0.79 * 0.5 / STEP)[:, 0] + white(0.01)[:, 0]
    assert visible_floor(x, STEP) is None


def test_a_slope_above_the_band_is_no_floor():
    """The response of a structure to broadband noise falls off above its band; that is not what its sensor adds."""
    frequency = np.fft.rfftfreq(SAMPLES, STEP)
    for power in (1, 2):
        spectrum = np.fft.rfft(white(1.0, seed=4)[:, 0]) / np.maximum(frequency, 1.0) ** power
        assert visible_floor(np.fft.irfft(spectrum, SAMPLES), STEP) is None


def low_passed(seed: int, count: int, cutoff: float = 0.5) -> np.ndarray:
    """Band-limited, with content up to a frequency per sample."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    return np.fft.irfft(np.where(np.fft.rfftfreq(count) <= cutoff, spectrum, 0.0), count)


def test_content_at_the_nyquist_frequency_falls_off_and_noise_does_not():
    rng = np.random.default_rng(3)
    falling = np.convolve(rng.standard_normal(3000), [0.5, 0.5], "valid")
    assert reaches_nyquist(falling, 0.01)
    smooth = low_passed(4, 3000, 0.2)
    assert not any(reaches_nyquist(smooth + 0.05 * rng.standard_normal(3000), 0.01) for _ in range(20))


@pytest.mark.parametrize("end", [0.63, 0.7, 0.76])
def test_content_that_ends_below_the_nyquist_frequency_leaves_noise_in_the_uppermost_tenth(end: float):
    """A cutoff is a share of the sampling rate."""
    rng = np.random.default_rng(5)
    for seed in range(10):
        ended = low_passed(seed, 3000, 0.5 * end)
        level = 0.01 * ended.std()
        assert not reaches_nyquist(ended + level * rng.standard_normal(3000), 0.01, level)
    falling = np.convolve(rng.standard_normal(3000), [0.5, 0.5], "valid")
    assert reaches_nyquist(falling + 0.01 * rng.standard_normal(2999), 0.01, 0.01)
