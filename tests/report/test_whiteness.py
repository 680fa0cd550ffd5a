"""Whether a residual is white: the test's own error rate, and what it sees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstwo

from pinn_cli.report.residuals import (
    MANY,
    autocorrelation,
    cumulated_deviation,
    cumulated_periodogram,
    exceeded,
    white_probability,
)


@pytest.mark.parametrize("samples", [16, 1024])
def test_of_white_noise_every_probability_is_as_likely_as_any_other(samples):
    rng = np.random.default_rng(samples)
    found = np.sort([white_probability(rng.normal(size=samples)) for _ in range(2000)])
    np.testing.assert_allclose(found, np.linspace(0.0, 1.0, 2000), atol=0.04)


@pytest.mark.parametrize("coefficient", [-0.4, 0.4])
def test_noise_with_a_memory_is_not_white(coefficient):
    noise = np.random.default_rng(0).normal(size=1001)
    assert white_probability(noise[1:] + coefficient * noise[:-1]) < 1e-6


@pytest.mark.parametrize("chance", [0.9, 0.5, 0.05, 1e-3, 1e-5])
@pytest.mark.parametrize("shares", [MANY, 20_000])
def test_the_limit_for_many_shares_is_right_to_a_hundredth(chance, shares):
    assert exceeded(kstwo.isf(chance, shares), shares) == pytest.approx(chance, rel=0.01)


def test_a_sine_is_all_at_its_frequency():
    shares = cumulated_periodogram(np.sin(2.0 * np.pi * np.arange(200) * 0.1))
    np.testing.assert_allclose(shares[[18, 19, 98]], [0.0, 1.0, 1.0], atol=1e-12)
    assert cumulated_deviation(np.sin(2.0 * np.pi * np.arange(200) * 0.1)) == pytest.approx(0.8, abs=0.02)


def test_autocorrelation_is_that_of_its_definition():
    values = np.array([1.0, -1.0, 2.0, -2.0])
    np.testing.assert_allclose(autocorrelation(values, 5), [-0.7, 0.4, -0.2, 0.0, 0.0])


def test_a_constant_has_neither():
    assert np.isnan(white_probability(np.ones(50)))
    assert np.isnan(autocorrelation(np.ones(50), 3)).all()
