"""Whitened coordinates: white at the mode, of constant determinant, and upright in the tail of a parameter at zero."""

from __future__ import annotations

import numpy as np
import pytest
from toy_likelihoods import correlated

from pinn_cli.posterior.target import Softplus, Whitening

MODE = np.array([0.5, 3.0, -1.0, 0.2])
COVARIANCE = correlated([1.0, 0.5, 2.0, 0.1], 0.8)
NEAR = np.array([3, 0])


@pytest.fixture(params=[0, 1, 2], ids="{} near zero".format)
def whitening(request) -> Whitening:
    near = NEAR[: request.param]
    return Whitening(MODE, np.linalg.inv(COVARIANCE), near, Softplus(np.sqrt(np.diag(COVARIANCE))[near]))


def jacobian(whitening: Whitening, q: np.ndarray) -> np.ndarray:
    """dx/dq (d, d) by central differences."""
    steps = 1e-5 * np.eye(len(q))
    return np.array([(whitening.coordinates(q + h) - whitening.coordinates(q - h)) / 2e-5 for h in steps]).T


def test_the_origin_is_the_mode_and_white(whitening):
    np.testing.assert_allclose(whitening.coordinates(np.zeros(4)), MODE)
    at_mode = jacobian(whitening, np.zeros(4))
    np.testing.assert_allclose(at_mode @ at_mode.T, COVARIANCE, rtol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_the_slope_is_the_chain_rules_and_the_determinant_constant(whitening, seed):
    generator = np.random.default_rng(seed)
    q, by_x = 2 * generator.standard_normal(4), generator.standard_normal(4)
    there = jacobian(whitening, q)
    np.testing.assert_allclose(whitening.slope(whitening.coordinates(q), by_x), by_x @ there, rtol=1e-6, atol=1e-8)
    assert np.linalg.det(there) ** 2 == pytest.approx(np.linalg.det(COVARIANCE), rel=1e-6)


def test_many_at_once(whitening):
    q = np.random.default_rng(0).standard_normal((2, 3, 4))
    together = whitening.coordinates(q)
    np.testing.assert_allclose(together[1, 2], whitening.coordinates(q[1, 2]), rtol=1e-14)


def test_far_below_zero_nothing_else_moves():
    softplus = Softplus(np.array([1.0]))
    whitening = Whitening(MODE, np.linalg.inv(COVARIANCE), np.array([0]), softplus)
    far, further = (whitening.coordinates(np.array([q, 0.0, 0.0, 0.0])) for q in (-30.0, -31.0))
    assert further[0] < far[0] - 0.5
    np.testing.assert_allclose(further[1:], far[1:], atol=1e-10)
