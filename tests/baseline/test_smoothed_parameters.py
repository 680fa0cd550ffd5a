"""The smoother's parameters: what cannot be negative has no interval below zero."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from pinn_cli.baseline.kalman_smoother import _parameters
from pinn_cli.system.parameters import Parameter

UNCERTAIN = (Parameter("k", 0, 10.0, 20.0, unknown=True, positive=True), Parameter("kappa", 0, 5.0, 3.0, unknown=True))


def smoothed(k: float, kappa: float):
    """Estimates whose Gaussian peaks at these distances, with one prior deviation of each, independently."""
    regression = SimpleNamespace(covariance=np.diag([1.0, 1.0, 7.0]))
    last = SimpleNamespace(trajectory=SimpleNamespace(parameters=np.array([k, kappa])), regression=regression)
    return _parameters(SimpleNamespace(problem=SimpleNamespace(uncertain=UNCERTAIN)), last)


def test_a_stiffness_below_zero_becomes_what_is_left_above():
    k, kappa = smoothed(-1.0, 0.0)
    expected = truncnorm(0.5, np.inf, -10.0, 20.0)
    assert k.held
    assert (k.estimate, k.std) == pytest.approx((expected.mean(), expected.std()))
    assert (k.lower_90, k.upper_90) == pytest.approx(tuple(expected.ppf([0.05, 0.95])))
    assert (kappa.estimate, kappa.held) == (5.0, False)
    assert (kappa.lower_90, kappa.upper_90) == pytest.approx(tuple(norm.ppf([0.05, 0.95], 5.0, 3.0)))
