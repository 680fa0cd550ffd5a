"""Histories between their samples: what is told in the middle, and what is left open at the ends."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.between_samples import LEAST_NOISE, refined_history, refined_times

SAMPLES = 400


def band_limited(highest: float, seed: int = 0, tones: int = 200):
    """A function of time in samples, with its power spread evenly up to ``highest`` cycles a sample; rms 1."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.0, highest, tones), rng.uniform(0.0, 2.0 * np.pi, tones)
    return lambda t: np.sqrt(2.0 / tones) * np.cos(2.0 * np.pi * frequency * t[:, None] + phase).sum(1)


@pytest.mark.parametrize("refinement", [2, 3, 5])
@pytest.mark.parametrize("highest", [0.1, 0.3, 0.39])
def test_the_middle_of_a_band_limited_history_is_told(highest, refinement):
    history = band_limited(highest)
    found, _ = refined_history(history(np.arange(SAMPLES))[:, None], refinement)
    truth = history(np.arange(len(found)) / refinement)
    middle = slice(40 * refinement, -40 * refinement)
    assert np.std((found[:, 0] - truth)[middle]) < 1e-4


@pytest.mark.parametrize("refinement", [2, 4])
def test_samples_stay_what_they_are(refinement):
    values = np.random.default_rng(0).normal(size=(50, 3))
    found, std = refined_history(values, refinement)
    assert found.shape == (49 * refinement + 1, 3)
    np.testing.assert_array_equal(found[::refinement], values)
    np.testing.assert_array_equal(std[::refinement], 0.0)


def test_one_point_a_sample_is_the_history_itself():
    values = np.random.default_rng(0).normal(size=(50, 2))
    found, std = refined_history(values, 1)
    np.testing.assert_array_equal(found, values)
    assert not std.any()


@pytest.mark.parametrize("refinement", [2, 3])
def test_the_standard_deviation_is_the_error_at_the_ends(refinement):
    """Over many histories that fill the band that the interpolation expects."""
    histories, count = [band_limited(0.45, seed, tones=100) for seed in range(300)], 100
    samples, fine = np.arange(count), np.arange((count - 1) * refinement + 1) / refinement
    found, std = refined_history(np.stack([h(samples) for h in histories], 1), refinement)
    error = np.sqrt(np.mean((found - np.stack([h(fine) for h in histories], 1)) ** 2, axis=1))
    between = np.arange(len(fine)) % refinement > 0
    ends = between & ((fine < 3.0) | (fine > count - 4.0))
    np.testing.assert_allclose(std[ends], error[ends], rtol=0.2)
    middle = between & (fine > 35.0) & (fine < count - 36.0)
    assert std[middle].max() < 1e-4 < 0.01 < std[ends].max()


def test_noisy_samples_are_not_blown_up():
    """Between white samples that a band fills, interpolation adds no more noise than a sample has."""
    noise = np.random.default_rng(0).normal(size=(SAMPLES, 100))
    for level in (0.0, 0.1):
        found, _ = refined_history(0.1 * noise, 3, level)
        middle = found[60:-60]
        assert middle[1::3].std() < 1.05 * 0.1
    assert LEAST_NOISE < 1e-6


def test_a_record_shorter_than_the_reach_is_interpolated_from_all_of_it():
    samples, rms = np.arange(40), 0.5**0.5
    found, std = refined_history(np.cos(samples)[:, None], 2)
    error = np.abs(found[:, 0] - np.cos(np.arange(79) / 2)) / rms
    assert np.all(error <= 3.0 * std + 1e-3)
    assert error[20:60].max() < 3e-3


def test_refined_times_pass_through_the_samples():
    time = np.array([0.0, 0.1, 0.2000001, 0.3])  # stamps that jitter stay
    found = refined_times(time, 4)
    np.testing.assert_array_equal(found[::4], time)
    assert np.all(np.diff(found) > 0)
    assert refined_times(time, 1) is time


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_a_noisy_history_keeps_its_size_up_to_nine_tenths_of_the_nyquist_frequency(noise):
    """What is most probable of it is smaller, by a hundredth at 20 dB."""
    history, rng = band_limited(0.45), np.random.default_rng(1)
    samples = history(np.arange(4000.0))
    found, _ = refined_history((samples + noise * rng.normal(size=4000))[:, None], 3, noise)
    truth, between = history(np.arange(len(found)) / 3), np.arange(len(found)) % 3 > 0
    assert found[between, 0] @ truth[between] / (truth[between] @ truth[between]) == pytest.approx(1.0, abs=0.003)
