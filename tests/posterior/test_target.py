"""The whitened posterior density and the likelihoods of parameters: gradients, modes, coordinates."""

import numpy as np
import pytest
from scipy import optimize
from toy_likelihoods import Everywhere, GaussianLikelihood, RegressionLikelihood, correlated, slopes

from pinn_cli.posterior.target import Softplus, Target, Whitening
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal
from pinn_cli.training.reported.parameter_likelihoods import (
    S_POINTS,
    S_RANGE,
    ConditionalLikelihood,
    MarginalLikelihood,
    ParameterLikelihood,
)

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
        slope = slopes(
            lambda coordinates: target.parameters(np.append(coordinates, x[-1])), x[:-1], 1e-6 * target.width
        )
        prior = sum(float(p.log_density(t)) for p, t in zip(PRIORS, theta, strict=True))
        return LIKELIHOOD.evaluate(theta, x[-1])[0] + prior + float(np.log(slope.max(axis=1)).sum())

    x, other = map(target.whitening.coordinates, (np.ones(5), np.array([-1.0, 0.5, -2.0, 0.3, 1.0])))
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


def test_where_the_likelihood_fails_the_density_is_zero_and_no_start_without_a_value_is_taken():
    class Failing(GaussianLikelihood):
        def evaluate(self, theta, s):
            if theta[0] > 2.0:
                raise np.linalg.LinAlgError("not positive definite")
            return super().evaluate(theta, s) if theta[0] < 1.5 else (np.nan, theta * np.nan, np.nan)

    target = Target(Failing([0.0], [[1.0]]), [Normal(0.0, 10.0)])
    for theta in (1.7, 2.5):
        assert target.log_density(np.array([theta, 0.0]))[0] == -np.inf

    class Nowhere(GaussianLikelihood):
        def evaluate(self, theta, s):
            return np.nan, theta, 0.0

    with pytest.raises(DivergenceError, match="cannot be evaluated at its start"):
        Target(Nowhere([0.0], [[1.0]]), [Normal(0.0, 10.0)])


MODE = np.array([0.5, 3.0, -1.0, 0.2])
COVARIANCE = correlated([1.0, 0.5, 2.0, 0.1], 0.8)
NEAR = np.array([3, 0])


@pytest.fixture(params=[0, 1, 2], ids="{} near zero".format)
def whitening(request) -> Whitening:
    near = NEAR[: request.param]
    return Whitening(MODE, np.linalg.inv(COVARIANCE), near, Softplus(np.sqrt(np.diag(COVARIANCE))[near]))


def jacobian(whitening: Whitening, q: np.ndarray) -> np.ndarray:
    """dx/dq (d, d)."""
    return slopes(whitening.coordinates, q, np.full(len(q), 1e-5)).T


@pytest.mark.parametrize("seed", range(4))
def test_the_origin_is_white_and_the_determinant_constant(whitening, seed):
    np.testing.assert_allclose(whitening.coordinates(np.zeros(4)), MODE)
    at_mode = jacobian(whitening, np.zeros(4))
    np.testing.assert_allclose(at_mode @ at_mode.T, COVARIANCE, rtol=1e-6)
    generator = np.random.default_rng(seed)
    several, by_x = 2 * generator.standard_normal((2, 3, 4)), generator.standard_normal(4)
    q = several[1, 2]
    there, x = jacobian(whitening, q), whitening.coordinates(q)
    np.testing.assert_allclose(whitening.coordinates(several)[1, 2], x, rtol=1e-14)
    np.testing.assert_allclose(whitening.slope(x, by_x), by_x @ there, rtol=1e-6, atol=1e-8)
    assert np.linalg.det(there) ** 2 == pytest.approx(np.linalg.det(COVARIANCE), rel=1e-6)


def test_softplus_is_its_own_inverse_and_far_below_zero_nothing_else_moves():
    of_three, x = Softplus(np.array([0.1, 1.0, 20.0])), np.array([-0.7, 3.0, 5.0])
    np.testing.assert_allclose(of_three.coordinates(of_three.parameters(x)), x, rtol=1e-10)
    softplus = Softplus(np.array([1.0]))
    whitening = Whitening(MODE, np.linalg.inv(COVARIANCE), np.array([0]), softplus)
    far, further = (whitening.coordinates(np.array([q, 0.0, 0.0, 0.0])) for q in (-30.0, -31.0))
    assert further[0] < far[0] - 0.5
    np.testing.assert_allclose(further[1:], far[1:], atol=1e-10)


STD = np.array([0.1, 2.0, 0.5])
PEAK = np.array([1.0, 15.0, -3.0])
S_MEAN, S_STD = 0.01, 0.02
NAMES, SIGMA = ("c_1", "k_1", "kappa_2"), np.array([0.1, np.nan])


def table() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return tabulated(np.linspace(-1.0, 1.0, S_POINTS) * S_RANGE * S_STD)


def tabulated(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """S, level, peak and precision of a likelihood all of which depends on s, and not in a polynomial way."""
    gram = np.linalg.inv(correlated(STD, 0.6))
    level = -1.5 * np.log(0.2 + 0.8 * np.exp(2.0 * s))
    peak = PEAK + STD * np.sin(3.0 * s)[:, None]
    precision = gram / (0.2 + 0.8 * np.exp(2.0 * s))[:, None, None]
    return s, level, peak, precision


def marginal() -> MarginalLikelihood:
    return MarginalLikelihood(NAMES, SIGMA, *table(), (S_MEAN, S_STD))


def told(s: float) -> float:
    """Logarithm of what residuals say of s."""
    return -0.5 * ((s - S_MEAN) / S_STD) ** 2


def unforced() -> MarginalLikelihood:
    """Without a force sensor nothing depends on s."""
    s, level, peak, precision = (values[2:3] for values in table())
    return MarginalLikelihood(NAMES, np.full(2, np.nan), s, level, peak, precision, (0.0, 1.0))


def conditional() -> ConditionalLikelihood:
    gram = np.linalg.inv(correlated(STD, 0.6)) * 0.04
    return ConditionalLikelihood(NAMES, np.array([True, False]), gram, PEAK, least=1200.0 * 0.04, count=1200)


def gradient(likelihood: ParameterLikelihood, theta: np.ndarray, s: float) -> np.ndarray:
    steps = 1e-4 * np.append(STD, likelihood.s_std)
    return slopes(lambda x: likelihood.evaluate(x[:-1], x[-1])[0], np.append(theta, s), steps)


@pytest.mark.parametrize("s", [-9.0, -6.1, -5.9, -2.0, 0.0, 0.7, 5.0, 6.5, 20.0], ids=lambda s: f"{s} deviations")
@pytest.mark.parametrize("make", [marginal, unforced, conditional])
def test_gradients_of_likelihoods_are_those_of_the_values(make, s):
    likelihood = make()
    for seed in range(3):
        theta = PEAK + 2.0 * STD * np.random.default_rng(seed).standard_normal(3)
        _, by_theta, by_s = likelihood.evaluate(theta, s * likelihood.s_std)
        numeric = gradient(likelihood, theta, s * likelihood.s_std)
        np.testing.assert_allclose(STD * by_theta, STD * numeric[:-1], rtol=1e-5, atol=1e-5)
        assert by_s * likelihood.s_std == pytest.approx(numeric[-1] * likelihood.s_std, rel=1e-5, abs=1e-4)


def test_the_slope_has_no_holes_where_the_scale_over_the_tables_width_is_rounded():
    likelihood, theta = marginal(), PEAK + STD
    s = np.linspace(-5.9, 5.9, 1001) * S_STD
    by_s = np.array([likelihood.evaluate(theta, place)[2] for place in s])
    assert np.abs(np.diff(by_s, 2)).max() < 1e-3 * np.abs(by_s).max()


@pytest.mark.parametrize("make", [marginal, unforced, conditional])
def test_peak_and_curvature_are_those_at_the_noise_that_was_found(make):
    likelihood = make()
    _, by_theta, _ = likelihood.evaluate(likelihood.peak, 0.0)
    np.testing.assert_allclose(STD * by_theta, 0.0, atol=1e-9)
    for step in np.diag(0.1 * STD):
        change = likelihood.evaluate(likelihood.peak + step, 0.0)[1]
        np.testing.assert_allclose(change, -likelihood.curvature @ step, rtol=1e-9, atol=1e-12)


def test_the_marginal_is_its_table_and_between_its_points_as_smooth_as_what_was_tabulated():
    likelihood, theta = marginal(), PEAK + STD * [1.0, -1.0, 0.5]
    between = np.linspace(-5.5, 5.5, 12) * S_STD
    for places, tolerance in ((table()[0], {"rel": 1e-9}), (between, {"abs": 2e-3})):
        for s, level, peak, precision in zip(*tabulated(places), strict=True):
            away = theta - peak
            expected = level - 0.5 * away @ precision @ away + told(s)
            assert likelihood.evaluate(theta, s)[0] == pytest.approx(expected, **tolerance)


def test_beyond_the_table_it_falls_as_a_gaussian_and_never_rises_again():
    likelihood = marginal()
    ends = [likelihood.evaluate(PEAK, s * S_STD) for s in (6.0, 8.0, 50.0, 1e6)]
    assert np.all(np.diff([value for value, *_ in ends]) < 0)
    assert ends[1][0] - ends[0][0] == pytest.approx(told(8.0 * S_STD) - told(6.0 * S_STD), rel=1e-9)
    assert ends[1][2] == pytest.approx(-7.5 / S_STD)
    left = [likelihood.evaluate(PEAK, -s * S_STD)[0] for s in (6.0, 8.0, 50.0, 1e6)]
    assert np.all(np.diff(left) < 0)
    assert np.isfinite(left).all()
    unseen = [unforced().evaluate(PEAK, s)[0] for s in (-0.5, 0.0, 0.5)]
    assert unseen == pytest.approx([unseen[0]] * 3)  # without a force sensor the noise tells nothing


def test_a_direction_that_hardly_anything_holds_stays_held_between_two_scales():
    """Two parameters of which a combination is known a thousand times as well, another one at every scale."""
    s = np.linspace(-0.3, 0.3, S_POINTS)
    turn = 1.0 + np.array([0.0, 0.02, -0.01, 0.03, 0.0])
    known = np.stack((turn, np.ones(S_POINTS)), axis=1)
    precision = 1e6 * known[:, :, None] * known[:, None, :] + np.eye(2)
    rows = s, np.zeros(S_POINTS), np.zeros((S_POINTS, 2)), precision
    likelihood = MarginalLikelihood(("beta_1", "gamma_1"), SIGMA, *rows, (0.0, 0.05))
    far = 10.0 * np.stack([np.array([np.cos(a), np.sin(a)]) for a in np.linspace(0.0, np.pi, 721)])
    for scale in np.linspace(s[0], s[-1], 13):
        peak = likelihood.evaluate(np.zeros(2), scale)[0]
        assert max(likelihood.evaluate(theta, scale)[0] for theta in far) < peak - 10.0
