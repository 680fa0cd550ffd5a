"""Estimates of parameters that bounds may cut off: always inside their intervals, and the mode where nothing is cut."""

import numpy as np
import pytest
from scipy.stats import truncnorm

from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.bounded_estimates import bounded_estimates


def parameters(count: int, prescribed: float, prior_std: float, positive: bool = True) -> list[Parameter]:
    return [Parameter("k", dof, prescribed, prior_std, unknown=True, positive=positive) for dof in range(count)]


@pytest.mark.parametrize("seed", range(60))
def test_every_estimate_lies_inside_its_interval(seed):
    """Bounds from far below the peak to far above it, correlations up to 0.9999, and misfit that hides them or not."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    mixed = rng.normal(size=(count, count)) + 10.0 ** rng.uniform(-1.0, 2.0) * np.ones((count, 1))
    unit = 10.0 ** rng.uniform(-6.0, 1.0, count)
    covariance = (mixed @ mixed.T + 1e-3 * np.eye(count)) * np.outer(unit, unit)
    spread = np.sqrt(covariance.diagonal())
    lower = np.where(rng.random(count) < 0.8, -np.abs(rng.normal(size=count)), -np.inf)
    reach = rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-1.0, 8.0, count)
    peak = np.where(np.isfinite(lower), lower, 0.0) + reach * spread
    misfit = rng.choice([0.0, 1.0]) * spread * 10.0 ** rng.uniform(-2.0, 2.0, count)
    uncertain = [
        Parameter("k", i, -float(low) if np.isfinite(low) else 1.0, 1.0, positive=bool(np.isfinite(low)))
        for i, low in enumerate(lower)
    ]
    mode = np.maximum(peak, lower)
    found = bounded_estimates(uncertain, np.ones(count), mode, TruncatedGaussian(peak, covariance, lower), misfit)
    for p, given in zip(uncertain, found, strict=True):
        assert given.lower_90 <= given.estimate <= given.upper_90
        assert given.lower_90 >= (0.0 if p.positive else -np.inf)
        assert given.std > 0.0


def test_a_bound_that_cuts_gives_the_mean_of_what_is_left():
    posterior = TruncatedGaussian(np.array([-3.0]), np.array([[4.0]]), np.array([-2.0]))
    (found,) = bounded_estimates(parameters(1, 20.0, 10.0), np.array([10.0]), np.array([-2.0]), posterior)
    expected = truncnorm(0.5, np.inf, 20.0 + 10.0 * -3.0, 20.0)
    assert found.held
    assert found.estimate == pytest.approx(expected.mean())
    assert (found.lower_90, found.upper_90) == pytest.approx(tuple(expected.ppf([0.05, 0.95])))


@pytest.mark.parametrize("below", [4.0, 40.0, np.inf])
def test_a_bound_that_is_far_leaves_the_mode_bit_for_bit(below):
    rng = np.random.default_rng(1)
    mode, unit = rng.normal(size=3) / 3.0, np.array([0.1, 3.0, 70.0])
    covariance = np.diag(np.full(3, 1e-4)) + 5e-5
    lower = mode - below * np.sqrt(covariance.diagonal())
    uncertain = [Parameter("k", dof, 1.1, 2.0) for dof in range(3)]
    found = bounded_estimates(uncertain, unit, mode, TruncatedGaussian(mode, covariance, lower))
    assert [p.estimate for p in found] == [1.1 + u * m for u, m in zip(unit, mode, strict=True)]
    assert not any(p.held for p in found)


def test_one_that_is_held_moves_those_that_are_correlated_with_it_into_their_intervals():
    """At a correlation of 0.999 the other's interval lies beside its mode."""
    covariance = np.array([[1.0, 0.999], [0.999, 1.0]])
    posterior = TruncatedGaussian(np.array([-3.0, 5.0]), covariance, np.array([0.0, -np.inf]))
    uncertain = [*parameters(1, 0.0, 1.0), Parameter("c", 0, 0.0, 1.0)]
    mode = np.array([0.0, 5.0 + 0.999 * 3.0])
    _, other = bounded_estimates(uncertain, np.ones(2), mode, posterior)
    assert other.estimate == pytest.approx(posterior.mean[1])
    assert other.lower_90 < other.estimate < other.upper_90


def test_without_parameters_there_is_nothing():
    nothing = np.zeros(0)
    assert bounded_estimates([], nothing, nothing, TruncatedGaussian(nothing, np.zeros((0, 0)), nothing)) == []
