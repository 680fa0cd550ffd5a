"""What bounds leave of a Gaussian, and of what a record says, against integrals and counted samples."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm, truncnorm

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.model.truncated_gaussian import TruncatedGaussian, tail_moments
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.reported.parameter_posterior import bounded_estimates

LOWER = np.array([0.0, -np.inf, 0.0])


def knowledge(mean: list[float], told: float = 0.0) -> ParameterKnowledge:
    """Three parameters in units of their own, the first two strongly correlated."""
    unit = np.array([1.0, 1e3, 1e-4])
    covariance = np.array([[1.0, -0.9, 0.2], [-0.9, 1.0, 0.1], [0.2, 0.1, 1.0]])
    weight = np.full(3, told**2) / unit**2
    return ParameterKnowledge(np.array(mean) * unit, covariance * np.outer(unit, unit), told / unit, weight, 1e2 * unit)


@pytest.mark.parametrize("told", [0.0, 0.5])
@pytest.mark.parametrize("first", [-6.0, -1.0, 0.5, 30.0])
def test_what_a_model_is_used_with_is_what_the_table_says(first, told):
    known = knowledge([first, 20.0, 50.0], told)
    uncertain = [
        Parameter(name, 0, 0.0, 1.0, positive=bool(low == 0.0)) for name, low in zip("ckm", LOWER, strict=True)
    ]
    posterior = TruncatedGaussian(known.mean, known.covariance, LOWER)
    mode = np.maximum(known.mean, LOWER)
    table = bounded_estimates(uncertain, np.ones(3), mode, posterior, known.hidden)
    mean, covariance = known.within(LOWER)
    np.testing.assert_allclose(mean, [p.estimate for p in table], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [p.std for p in table], rtol=1e-9)
    assert np.linalg.eigvalsh(covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))).min() > 0.0


def test_the_most_probable_values_above_a_bound_move_along_with_the_one_that_it_holds():
    known = knowledge([-6.0, 20.0, 50.0])
    found = known.most_probable(LOWER)
    np.testing.assert_allclose(found, [0.0, (20.0 - 0.9 * 6.0) * 1e3, (50.0 + 0.2 * 6.0) * 1e-4], atol=1e-6)
    inside = knowledge([6.0, 20.0, 50.0])
    np.testing.assert_array_equal(inside.most_probable(LOWER), inside.mean)


PROBABILITIES = (0.05, 0.95)


@pytest.mark.parametrize("cut", [-40.0, -8.0, -1.0, 0.0, 0.7, 5.0, 30.0, 99.0, 101.0, 1e3, 1e6])
def test_moments_of_a_tail_are_its_integrals(cut):
    # z = cut + t: the density falls off as exp(-cut t - t^2 / 2), and nothing overflows.
    top, unit = max(0.0, -cut), 1.0 / (1.0 + max(cut, 0.0))
    weights = [
        quad(lambda s, q=q: (s * unit) ** q * np.exp(-cut * s * unit - (s * unit) ** 2 / 2 - top**2 / 2), 0.0, end)[0]
        for q, end in ((q, 40.0 + (top + 40.0) / unit * (cut < 0)) for q in range(3))
    ]
    excess, square = weights[1] / weights[0], weights[2] / weights[0]
    mean, variance = tail_moments(cut)
    assert mean - cut == pytest.approx(excess, rel=1e-5)
    assert variance == pytest.approx(square - excess**2, rel=1e-5)


@pytest.mark.parametrize("peak", [-30.0, -8.0, -1.0, 0.0, 2.0, 50.0])
def test_one_coordinate_is_scipys_truncated_normal(peak):
    spread, lower = 2.5, -1.0
    found = TruncatedGaussian(np.array([peak]), np.array([[spread**2]]), np.array([lower]))
    expected = truncnorm((lower - peak) / spread, np.inf, peak, spread)
    assert found.mean[0] == pytest.approx(expected.mean(), rel=1e-6)
    assert found.covariance[0, 0] == pytest.approx(expected.var(), rel=1e-5)
    np.testing.assert_allclose(found.marginals(PROBABILITIES).quantiles[:, 0], expected.ppf(PROBABILITIES), rtol=1e-9)


def correlated(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Peaks some standard deviations from zero, and a covariance in units that span eight decades."""
    rng = np.random.default_rng(seed)
    mixed, unit = rng.normal(size=(count, count)), 10.0 ** rng.uniform(-4.0, 4.0, count)
    covariance = (mixed @ mixed.T + 0.3 * np.eye(count)) * unit * unit[:, None]
    return rng.normal(size=count) * np.sqrt(np.diag(covariance)), covariance


def test_without_bounds_near_it_is_the_gaussian_itself():
    peak, covariance = correlated(0, 4)
    spread = np.sqrt(np.diag(covariance))
    found = TruncatedGaussian(peak, covariance, np.full(4, -np.inf))
    np.testing.assert_array_equal(found.mean, peak)
    np.testing.assert_array_equal(found.covariance, covariance)
    half = norm.ppf(0.95) * spread
    np.testing.assert_allclose(found.marginals(PROBABILITIES).quantiles, [peak - half, peak + half], rtol=1e-9)
    bounded = TruncatedGaussian(peak, covariance, peak - 12.0 * spread)
    np.testing.assert_allclose(bounded.mean, peak, rtol=1e-12)
    np.testing.assert_allclose(bounded.covariance, covariance, rtol=1e-9)


def test_marginals_have_the_moments_of_what_is_left():
    peak, covariance = correlated(3, 4)
    found = TruncatedGaussian(peak, covariance, np.array([0.0, 0.0, -np.inf, 0.0]))
    np.testing.assert_allclose(found.marginals(PROBABILITIES).std, np.sqrt(np.diag(found.covariance)), rtol=1e-7)


def test_an_error_of_its_own_widens_a_coordinate_and_still_respects_its_bound():
    covariance, lower = np.array([[4.0, 1.8], [1.8, 1.0]]), np.array([0.0, -np.inf])
    found, error = TruncatedGaussian(np.array([-1.0, 3.0]), covariance, lower), np.array([1.5, 0.7])
    _, spread, ends = found.marginals(PROBABILITIES, error)
    wider = np.hypot(2.0, 1.5)
    expected = truncnorm(1.0 / wider, np.inf, -1.0, wider)
    assert spread[0] == pytest.approx(expected.std())
    np.testing.assert_allclose(ends[:, 0], expected.ppf(PROBABILITIES))
    half = np.hypot(found.covariance[1, 1] ** 0.5, 0.7)
    assert spread[1] == pytest.approx(half)
    np.testing.assert_allclose(ends[:, 1], found.mean[1] + norm.ppf(PROBABILITIES) * half)


@pytest.mark.parametrize("below", [-1.0, 0.5, 4.0, 300.0])
def test_one_bound_moves_the_others_as_far_as_they_are_correlated(below):
    """E[y] = peak of y + slope (E[x] - peak of x), and so with the variance: exact for one bound."""
    peak, covariance = correlated(2, 4)
    lower = np.full(4, -np.inf)
    lower[1] = peak[1] + below * np.sqrt(covariance[1, 1])
    mean, variance = tail_moments(below)
    slope = covariance[:, 1] / covariance[1, 1]
    found = TruncatedGaussian(peak, covariance, lower)
    unit = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.mean / unit, (peak + slope * np.sqrt(covariance[1, 1]) * mean) / unit, rtol=1e-7)
    expected = covariance + np.outer(slope, slope) * covariance[1, 1] * (variance - 1.0)
    np.testing.assert_allclose(found.covariance / np.outer(unit, unit), expected / np.outer(unit, unit), atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_several_bounds_against_counted_samples(seed):
    peak, covariance = correlated(seed, 4)
    unit, lower = np.sqrt(np.diag(covariance)), np.array([0.0, 0.0, -np.inf, 0.0])
    found = TruncatedGaussian(peak, covariance, lower)
    drawn = np.random.default_rng(seed).normal(size=(400_000, 4)) @ np.linalg.cholesky(covariance).T + peak
    kept = drawn[(drawn >= lower).all(axis=1)]
    assert len(kept) > 400
    few = 4.0 / np.sqrt(len(kept))
    np.testing.assert_allclose(found.mean / unit, kept.mean(axis=0) / unit, atol=0.02 + few)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), kept.std(axis=0), rtol=0.08 + few)
    ends = found.marginals(PROBABILITIES).quantiles
    assert np.all(ends[0] >= lower)
    covered = ((kept >= ends[0]) & (kept <= ends[1])).mean(axis=0)
    np.testing.assert_allclose(covered, 0.9, atol=0.03 + few / 2)
