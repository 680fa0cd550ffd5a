"""Histories between their samples: what is told in the middle, what is left open at the ends, holds, straight lines."""

import numpy as np
import pytest
from vibrating_records import low_passed

from pinn_cli.record.between_samples import (
    BandLimited,
    Held,
    between_samples,
    held_by_lines,
    refined,
    samples_per_line,
)

SAMPLES = 400


def band_limited(highest: float, seed: int = 0, tones: int = 200, gap: tuple[float, float] = (0.0, 0.0)):
    """A function of time in samples, with its power spread evenly up to ``highest`` cycles a sample; rms 1."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.0, highest, tones), rng.uniform(0.0, 2.0 * np.pi, tones)
    frequency = frequency[(frequency < gap[0]) | (frequency > gap[1])]
    phase, tones = phase[: len(frequency)], len(frequency)
    return lambda t: np.sqrt(2.0 / tones) * np.cos(2.0 * np.pi * frequency * t[:, None] + phase).sum(1)


@pytest.mark.parametrize("refinement", [2, 4])
def test_samples_stay_what_they_are(refinement):
    values = np.random.default_rng(0).normal(size=(50, 3))
    found, std = refined(values, refinement)
    assert found.shape == (49 * refinement + 1, 3)
    np.testing.assert_array_equal(found[::refinement], values)
    np.testing.assert_array_equal(std[::refinement], 0.0)


@pytest.mark.parametrize("refinement", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_standard_deviation_is_the_error_at_the_ends(refinement):
    """Over many histories that fill the band that the interpolation expects."""
    # A gap in the band shows that there is no noise.
    histories, count = [band_limited(0.47, seed, gap=(0.19, 0.236)) for seed in range(300)], SAMPLES
    fine = np.arange((count - 1) * refinement + 1) / refinement
    truth = np.stack([h(fine) for h in histories], 1)
    found, std = refined(truth[::refinement], refinement)
    error = np.sqrt(np.mean((found - truth) ** 2, axis=1))
    std = np.sqrt(np.mean(std**2, axis=1))
    between = np.arange(len(fine)) % refinement > 0
    ends = between & ((fine < 3.0) | (fine > count - 4.0))
    np.testing.assert_allclose(std[ends], error[ends], rtol=0.2)
    middle = between & (fine > 35.0) & (fine < count - 36.0)
    assert std[middle].max() < 1e-4 < 0.01 < std[ends].max()


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_a_noisy_history_keeps_its_size_up_to_nine_tenths_of_the_nyquist_frequency(noise):
    """What is most probable of it is smaller, by a hundredth at 20 dB."""
    history, rng = band_limited(0.45), np.random.default_rng(1)
    samples = history(np.arange(4000.0))
    found, _ = refined((samples + noise * rng.normal(size=4000))[:, None], 3)
    truth, between = history(np.arange(len(found)) / 3), np.arange(len(found)) % 3 > 0
    assert found[between, 0] @ truth[between] / (truth[between] @ truth[between]) == pytest.approx(1.0, abs=0.003)


@pytest.mark.parametrize("part", [0.05, 0.25, 0.5, 0.9])
def test_a_force_up_to_a_part_of_the_nyquist_frequency_is_followed_between_its_samples(part):
    rng, time = np.random.default_rng(0), np.arange(1000.0)
    omega, phase = rng.uniform(0.0, np.pi * part, 60), rng.uniform(0.0, 2.0 * np.pi, 60)

    def exact(at: np.ndarray) -> np.ndarray:
        return np.cos(at[:, None] * omega + phase).sum(axis=1)

    between = time[:-1] + 0.4
    off = np.abs(BandLimited(time, exact(time))(between) - exact(between)) / np.std(exact(time))
    two = np.stack((exact(time), np.zeros(1000)), axis=1)
    np.testing.assert_array_equal(BandLimited(time, two)(time[:6].reshape(2, 3))[..., 1], np.zeros((2, 3)))
    assert off[50:-50].max() < 1e-4
    assert off.max() < 0.15


def test_a_slow_history_is_told_at_its_ends_as_well_as_its_noise_allows():
    """And by no more than it is in error: a slow one is no history that fills the band."""
    places, ends = np.arange(2 * SAMPLES - 1) / 2, [1, 3, 5, -6, -4, -2]
    truth = np.stack([band_limited(0.1, seed)(places) for seed in range(40)], 1)
    for noise in (0.0, 1e-3, 1e-2):
        white = np.random.default_rng(0).normal(size=(SAMPLES, 40))
        found, std = refined(truth[::2] + noise * white, 2)
        assert np.sqrt(np.mean((found - truth)[ends] ** 2)) < 1.6 * noise + 1e-3
        assert np.sqrt(np.mean(std[ends] ** 2)) < 1.6 * noise + 1e-3


def test_a_held_history_keeps_its_samples():
    time, values = 0.1 * np.arange(30), np.random.default_rng(0).normal(size=(30, 2))
    history = between_samples(time, values, "zero_order_hold")
    assert isinstance(history, Held)
    np.testing.assert_array_equal(history(time), values)
    np.testing.assert_array_equal(history(time[:-1] + 0.09), values[:-1])
    np.testing.assert_array_equal(history.within(np.array([0.0, 0.5, 1.0])), np.stack([values[:-1]] * 3))


def interpolated(values: np.ndarray, every: int) -> np.ndarray:
    places = np.arange(every * (len(values) - 1) + 1) / every
    return np.interp(places, np.arange(len(values)), values)


@pytest.mark.parametrize("every", [1, 2, 5])
def test_what_lines_hold_below_the_nyquist_frequency_moves_a_slow_mass_as_the_lines_do(every: int):
    """Against the lines themselves, a hundred times as dense, behind an ideal low-pass filter."""
    samples = interpolated(low_passed(0, 600), every)
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
    lines = interpolated(low_passed(1, 400), every)
    noisy = lines + 10 ** (-snr_db / 20) * lines.std() * np.random.default_rng(2).standard_normal(len(lines))
    assert samples_per_line(noisy) == every


@pytest.mark.parametrize("cutoff", [0.02, 0.1, 0.3, 0.5])
def test_a_signal_without_lines_has_none(cutoff: float):
    for seed in range(40):
        signal = low_passed(seed, 1000, cutoff) * np.exp(-np.linspace(0.0, 6.0, 1000))
        white = np.random.default_rng(seed).standard_normal(1000)
        assert samples_per_line(signal + 0.01 * signal.std() * white) == 1
    assert samples_per_line(np.zeros(1000)) == 1
    assert samples_per_line(np.arange(5.0)) == 1
