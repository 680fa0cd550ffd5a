"""Straight lines between samples."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.interpolation import held_by_lines, samples_per_line
from pinn_cli.record.spectrum import reaches_nyquist


def noise(seed: int, count: int, cutoff: float = 0.5) -> np.ndarray:
    """Band-limited, with content up to a frequency per sample."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(count))
    return np.fft.irfft(np.where(np.fft.rfftfreq(count) <= cutoff, spectrum, 0.0), count)


def interpolated(values: np.ndarray, every: int) -> np.ndarray:
    places = np.arange(every * (len(values) - 1) + 1) / every
    return np.interp(places, np.arange(len(values)), values)


@pytest.mark.parametrize("every", [1, 2, 5])
def test_what_lines_hold_below_the_nyquist_frequency_moves_a_slow_mass_as_the_lines_do(every: int):
    """Against the lines themselves, a hundred times as dense, behind an ideal low-pass filter."""
    samples = interpolated(noise(0, 600), every)
    dense = interpolated(samples, 100)
    spectrum = np.fft.rfft(dense * np.hanning(len(dense)))
    spectrum[np.fft.rfftfreq(len(dense), 0.01) > 0.5] = 0.0
    expected = np.fft.irfft(spectrum, len(dense))[::100]
    found = held_by_lines(samples) * np.hanning(len(dense))[::100]
    inside = slice(50, -50)
    assert np.std(found[inside] - expected[inside]) < 0.01 * np.std(expected)
    assert np.std(samples * np.hanning(len(dense))[::100] - expected) > 0.02 * np.std(expected)


@pytest.mark.parametrize("every", [2, 3, 5])
@pytest.mark.parametrize("snr_db", [30.0, 60.0])
def test_lines_over_several_samples_are_found_in_noise(every: int, snr_db: float):
    lines = interpolated(noise(1, 400), every)
    noisy = lines + 10 ** (-snr_db / 20) * lines.std() * np.random.default_rng(2).standard_normal(len(lines))
    assert samples_per_line(noisy) == every


@pytest.mark.parametrize("cutoff", [0.02, 0.1, 0.3, 0.5])
def test_a_signal_without_lines_has_none(cutoff: float):
    for seed in range(40):
        signal = noise(seed, 1000, cutoff) * np.exp(-np.linspace(0.0, 6.0, 1000))
        white = np.random.default_rng(seed).standard_normal(1000)
        assert samples_per_line(signal + 0.01 * signal.std() * white) == 1
    assert samples_per_line(np.zeros(1000)) == 1
    assert samples_per_line(np.arange(5.0)) == 1


def test_content_at_the_nyquist_frequency_falls_off_and_noise_does_not():
    rng = np.random.default_rng(3)
    falling = np.convolve(rng.standard_normal(3000), [0.5, 0.5], "valid")
    assert reaches_nyquist(falling, 0.01)
    smooth = noise(4, 3000, 0.2)
    assert not any(reaches_nyquist(smooth + 0.05 * rng.standard_normal(3000), 0.01) for _ in range(20))


@pytest.mark.parametrize("end", [0.63, 0.7, 0.76])
def test_content_that_ends_below_the_nyquist_frequency_leaves_noise_in_the_uppermost_tenth(end: float):
    """A cutoff is a share of the sampling rate."""
    rng = np.random.default_rng(5)
    for seed in range(10):
        ended = noise(seed, 3000, 0.5 * end)
        level = 0.01 * ended.std()
        assert not reaches_nyquist(ended + level * rng.standard_normal(3000), 0.01, level)
    falling = np.convolve(rng.standard_normal(3000), [0.5, 0.5], "valid")
    assert reaches_nyquist(falling + 0.01 * rng.standard_normal(2999), 0.01, 0.01)
