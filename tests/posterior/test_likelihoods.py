"""The two likelihoods of parameters, on matrices of their own: gradients, what they are at their peaks, and beyond."""

import numpy as np
import pytest
from toy_likelihoods import correlated, slopes

from pinn_cli.training.likelihood import ParameterLikelihood
from pinn_cli.training.reported.parameter_likelihoods import (
    S_POINTS,
    S_RANGE,
    ConditionalLikelihood,
    MarginalLikelihood,
)

STD = np.array([0.1, 2.0, 0.5])
PEAK = np.array([1.0, 15.0, -3.0])
S_MEAN, S_STD = 0.01, 0.02
NAMES, SIGMA = ("c_1", "k_1", "kappa_2"), np.array([0.1, np.nan])


def table() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """S, level, peak and precision of a likelihood all of which depends on s, and not in a polynomial way."""
    s = np.linspace(-1.0, 1.0, S_POINTS) * S_RANGE * S_STD
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
    def value(x: np.ndarray) -> float:
        return likelihood.evaluate(x[:-1], x[-1])[0]

    return slopes(value, np.append(theta, s), np.append(1e-4 * STD, 1e-4 * likelihood.s_std))


@pytest.mark.parametrize("s", [-9.0, -6.1, -5.9, -2.0, 0.0, 0.7, 5.0, 6.5, 20.0], ids=lambda s: f"{s} deviations")
@pytest.mark.parametrize("make", [marginal, unforced, conditional])
def test_gradients_are_those_of_the_values(make, s):
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
    steps = [0.1 * width * unit for width, unit in zip(STD, np.eye(3), strict=True)]
    for step in steps:
        change = likelihood.evaluate(likelihood.peak + step, 0.0)[1]
        np.testing.assert_allclose(change, -likelihood.curvature @ step, rtol=1e-9, atol=1e-12)


def test_the_marginal_is_its_table_at_the_tables_points():
    likelihood = marginal()
    theta = PEAK + STD
    for s, level, peak, precision in zip(*table(), strict=True):
        away = theta - peak
        expected = level - 0.5 * away @ precision @ away + told(s)
        assert likelihood.evaluate(theta, s)[0] == pytest.approx(expected, rel=1e-9)


def test_between_the_points_it_is_as_smooth_as_what_was_tabulated():
    likelihood, theta = marginal(), PEAK + STD * [1.0, -1.0, 0.5]
    for s in np.linspace(-5.5, 5.5, 12) * S_STD:
        level = told(s) - 1.5 * np.log(0.2 + 0.8 * np.exp(2.0 * s))
        away = theta - PEAK - STD * np.sin(3.0 * s)
        gram = np.linalg.inv(correlated(STD, 0.6)) / (0.2 + 0.8 * np.exp(2.0 * s))
        assert likelihood.evaluate(theta, s)[0] == pytest.approx(level - 0.5 * away @ gram @ away, abs=2e-3)


def test_beyond_the_table_it_falls_as_a_gaussian_and_never_rises_again():
    likelihood = marginal()
    ends = [likelihood.evaluate(PEAK, s * S_STD) for s in (6.0, 8.0, 50.0, 1e6)]
    assert np.all(np.diff([value for value, *_ in ends]) < 0)
    assert ends[1][0] - ends[0][0] == pytest.approx(told(8.0 * S_STD) - told(6.0 * S_STD), rel=1e-9)
    assert ends[1][2] == pytest.approx(-7.5 / S_STD)
    left = [likelihood.evaluate(PEAK, -s * S_STD)[0] for s in (6.0, 8.0, 50.0, 1e6)]
    assert np.all(np.diff(left) < 0)
    assert np.isfinite(left).all()


def test_without_a_force_sensor_the_noise_tells_nothing():
    likelihood = unforced()
    values = [likelihood.evaluate(PEAK, s)[0] for s in (-0.5, 0.0, 0.5)]
    assert values == pytest.approx([values[0]] * 3)


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
