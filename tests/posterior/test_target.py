"""The whitened posterior density: its gradient, its mode, its coordinates."""

import numpy as np
import pytest
from scipy import optimize
from toy_likelihoods import Everywhere, GaussianLikelihood, RegressionLikelihood, correlated, slopes

from pinn_cli.posterior.target import Softplus, Target, Whitening
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal

PRIORS = [Gamma(2.0, 0.1), Normal(0.0, 5.0), HalfNormal(30.0), LogNormal(10.0, 0.5)]
LIKELIHOOD = RegressionLikelihood([1.0, -0.5, 15.0, 9.0], correlated([0.3, 0.2, 0.5, 2.0], 0.8))


@pytest.fixture(scope="module")
def target() -> Target:
    return Target(LIKELIHOOD, PRIORS)


@pytest.mark.parametrize("seed", range(5))
def test_gradients_are_those_of_the_values(target, seed):
    q = 2 * np.random.default_rng(seed).standard_normal(target.size)
    numeric = slopes(lambda q: target.potential(q)[0], q, np.full(target.size, 1e-5))
    np.testing.assert_allclose(target.potential(q)[1], numeric, rtol=1e-6, atol=1e-6)
    x = target.whitening.coordinates(q)
    numeric = slopes(lambda x: target.log_density(x)[0], x, 1e-5 / np.sqrt(np.diag(target.precision)))
    np.testing.assert_allclose(target.log_density(x)[1], numeric, rtol=1e-5, atol=1e-5)


def test_the_density_is_that_of_the_parameters_with_the_jacobian(target):
    """By finite differences of the transform, at two points: the difference has no constant."""

    def expected(x: np.ndarray) -> float:
        theta = target.parameters(x)
        steps = np.append(1e-6 * target.width, 0.0)
        slope = [
            ((target.parameters(x + h) - target.parameters(x - h)) / (2 * h.sum())).max() for h in np.diag(steps)[:-1]
        ]
        prior = sum(float(p.log_density(t)) for p, t in zip(PRIORS, theta, strict=True))
        return LIKELIHOOD.evaluate(theta, x[-1])[0] + prior + float(np.log(slope).sum())

    x, other = (
        target.whitening.coordinates(np.ones(5)),
        target.whitening.coordinates(np.array([-1.0, 0.5, -2.0, 0.3, 1.0])),
    )
    difference = target.log_density(x)[0] - target.log_density(other)[0]
    s_prior = -0.5 * (x[-1] ** 2 - other[-1] ** 2) / 100
    assert difference == pytest.approx(expected(x) - expected(other) + s_prior, rel=1e-6)


def test_the_mode_is_the_peak_and_the_coordinates_are_white_there(target):
    value, gradient = target.potential(np.zeros(target.size))
    np.testing.assert_allclose(gradient, 0.0, atol=1e-5)
    found = optimize.minimize(lambda q: target.potential(q)[0], np.full(target.size, 0.3), method="Nelder-Mead")
    assert value <= found.fun + 1e-8
    hessian = [slopes(lambda q, i=i: target.potential(q)[1][i], np.zeros(5), np.full(5, 1e-4)) for i in range(5)]
    np.testing.assert_allclose(hessian, np.eye(5), atol=1e-5)


def test_a_likelihood_that_peaks_below_zero_has_its_posterior_above():
    target = Target(GaussianLikelihood([-3.0, 2.0], correlated([1.0, 1.0], 0.9)), [HalfNormal(10.0), HalfNormal(10.0)])
    theta = target.parameters(target.whitening.coordinates(np.random.default_rng(0).standard_normal((100, 3))))
    assert np.all(theta > 0)
    np.testing.assert_allclose(target.potential(np.zeros(3))[1], 0.0, atol=1e-5)


def test_a_record_that_says_nothing_leaves_the_prior():
    target = Target(Everywhere(2), [Normal(3.0, 2.0), Gamma(9.0, 3.0)])
    assert target.mode[0] == pytest.approx(3.0)
    assert 1 / np.sqrt(target.precision[0, 0]) == pytest.approx(2.0, rel=1e-6)
    assert 2.0 < target.parameters(target.mode)[1] < 4.0


def test_flat_directions_of_the_likelihood_are_held_by_the_prior():
    likelihood = GaussianLikelihood([1.0, 1.0], np.eye(2))
    likelihood.curvature = np.array([[1e8, -1e8], [-1e8, 1e8]])  # only the difference is known
    target = Target(likelihood, [Normal(5.0, 2.0), Normal(5.0, 2.0)])
    np.testing.assert_allclose(target.mode[:2], 5.0, rtol=1e-6)


def test_where_the_likelihood_fails_the_density_is_zero():
    class Failing(GaussianLikelihood):
        def evaluate(self, theta, s):
            if theta[0] > 2.0:
                raise np.linalg.LinAlgError("not positive definite")
            return super().evaluate(theta, s) if theta[0] < 1.5 else (np.nan, theta * np.nan, np.nan)

    target = Target(Failing([0.0], [[1.0]]), [Normal(0.0, 10.0)])
    for theta in (1.7, 2.5):
        assert target.log_density(np.array([theta, 0.0]))[0] == -np.inf


def test_a_posterior_without_a_value_at_its_start_is_told():
    class Nowhere(GaussianLikelihood):
        def evaluate(self, theta, s):
            return np.nan, theta, 0.0

    with pytest.raises(DivergenceError, match="cannot be evaluated at its start"):
        Target(Nowhere([0.0], [[1.0]]), [Normal(0.0, 10.0)])


def test_softplus_is_its_own_inverse_and_has_these_slopes():
    softplus = Softplus(np.array([0.1, 1.0, 20.0]))
    x = np.array([-0.7, 3.0, 5.0])
    theta = softplus.parameters(x)
    assert np.all(theta > 0)
    np.testing.assert_allclose(softplus.coordinates(theta), x, rtol=1e-10)
    steps = np.full(3, 1e-6)
    by_x, log_by_x, bend = softplus.slopes(theta)
    total = slopes(lambda x: softplus.parameters(x).sum(), x, steps)
    np.testing.assert_allclose(by_x, total, rtol=1e-6)
    np.testing.assert_allclose(log_by_x, np.log(total), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(
        bend, slopes(lambda x: softplus.slopes(softplus.parameters(x))[1].sum(), x, steps), rtol=1e-5
    )


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
