"""Filter, smoother and likelihood against the dense Gaussian posterior."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from pinn_cli.baseline.iterated_smoother import regress
from pinn_cli.baseline.linear_gaussian import LinearGaussian


def random_model(steps: int = 7, s: int = 3, d: int = 2, m: int = 2, p: int = 2, seed: int = 0) -> LinearGaussian:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(m + s, m + s))
    return LinearGaussian(
        observed=rng.normal(size=(steps, m)),
        offset=rng.normal(size=(steps, m + s)),
        state=0.5 * rng.normal(size=(steps, m + s, s)),
        disturbance=rng.normal(size=(steps, m + s, d)),
        coefficient=rng.normal(size=(steps, m + s, p)),
        disturbance_variance=np.linspace(0.5, 2.0, d),
        noise=np.diag(np.diag(root @ root.T)),
        initial=rng.normal(size=(s, p)),
    )


@dataclass(frozen=True)
class Dense:
    """The joint Gaussian of everything, as matrices acting on independent standard variables (b, e, noise)."""

    states: np.ndarray
    disturbances: np.ndarray
    observations: np.ndarray
    variance: np.ndarray
    state_mean: np.ndarray
    observation_mean: np.ndarray

    @classmethod
    def of(cls, model: LinearGaussian) -> "Dense":
        (steps, m), (s, p), d = model.observed.shape, model.initial.shape, model.disturbance.shape[2]
        width = p + steps * (d + m + s)
        x, mean = np.zeros((s, width)), np.zeros(s)
        x[:, :p] = model.initial
        rows: list[list[np.ndarray]] = [[], [], [], [], []]
        for k in range(steps):
            at = p + k * (d + m + s)
            e, noise, b = np.zeros((d, width)), np.zeros((m + s, width)), np.zeros((p, width))
            e[:, at : at + d], noise[:, at + d : at + d + m + s], b[:, :p] = np.eye(d), np.eye(m + s), np.eye(p)
            out = model.state[k] @ x + model.disturbance[k] @ e + model.coefficient[k] @ b + noise
            out_mean = model.state[k] @ mean + model.offset[k]
            for row, value in zip(rows, (x, e, out[:m], mean, out_mean[:m]), strict=True):
                row.append(value)
            x, mean = out[m:], out_mean[m:]
        once = np.concatenate((model.disturbance_variance, np.diag(model.noise)))
        variance = np.concatenate((np.ones(p), np.tile(once, steps)))
        states, disturbances, observations = (np.stack(row) for row in rows[:3])
        return cls(states, disturbances, observations, variance, np.stack(rows[3]), np.concatenate(rows[4]))

    def posterior(self, observed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the independent variables: mean and covariance."""
        rows = self.observations.reshape(-1, len(self.variance))
        cross = self.variance[:, None] * rows.T
        gain = np.linalg.solve(rows @ cross, cross.T).T
        return gain @ (observed.ravel() - self.observation_mean), np.diag(self.variance) - gain @ cross.T

    def log_density(self, observed: np.ndarray) -> float:
        rows = self.observations.reshape(-1, len(self.variance))
        return float(multivariate_normal(self.observation_mean, rows * self.variance @ rows.T).logpdf(observed.ravel()))


@pytest.mark.parametrize("p", [0, 2])
def test_everything_equals_the_dense_gaussian_posterior(p: int) -> None:
    model = random_model(p=p)
    dense = Dense.of(model)
    mean, covariance = dense.posterior(model.observed)
    filtered = model.filter()
    found = regress(filtered, np.zeros(p), np.ones(p))
    np.testing.assert_allclose(found.change, mean[:p], atol=1e-10)
    np.testing.assert_allclose(found.covariance, covariance[:p, :p], atol=1e-10)
    states, disturbances = filtered.smooth(found.change)
    np.testing.assert_allclose(states, dense.states @ mean + dense.state_mean, atol=1e-10)
    np.testing.assert_allclose(disturbances, dense.disturbances @ mean, atol=1e-10)
    spread, by_coefficient = filtered.posterior()
    spread = spread + by_coefficient @ found.covariance @ by_coefficient.transpose(0, 2, 1)
    together = np.concatenate((dense.states, dense.disturbances), axis=1)
    np.testing.assert_allclose(spread, together @ covariance @ together.transpose(0, 2, 1), atol=1e-10)


def test_the_evidence_is_the_log_density_of_the_observations() -> None:
    model = random_model()
    with pytest.raises(FloatingPointError, match="sample 0"):  # of impossible noise there is none
        replace(model, noise=-1e3 * np.eye(5)).filter()
    constant = -0.5 * model.observed.size * np.log(2.0 * np.pi)
    found = regress(model.filter(), np.zeros(2), np.ones(2))
    assert found.log_evidence + constant == pytest.approx(Dense.of(model).log_density(model.observed), abs=1e-9)


def test_a_spread_is_a_factor_on_the_prior_standard_deviation() -> None:
    model, spread = random_model(), 3.0
    wide = replace(model, coefficient=model.coefficient * [1.0, spread], initial=model.initial * [1.0, spread])
    as_factor = regress(model.filter(), np.zeros(2), np.array([1.0, spread**-2]))
    as_unit = regress(wide.filter(), np.zeros(2), np.ones(2))
    assert as_factor.log_evidence == pytest.approx(as_unit.log_evidence, abs=1e-9)
    np.testing.assert_allclose(as_factor.change, as_unit.change * [1.0, spread], atol=1e-10)


def test_squares_less_information_are_twice_the_slope_of_the_evidence_by_every_variance() -> None:
    model, small = random_model(), 1e-5
    filtered = model.filter()
    found = regress(filtered, np.zeros(2), np.ones(2))
    noise, left = filtered.information_on_noise(found.change, found.covariance)
    squares, information = np.sum(noise**2, axis=0), np.sum(left, axis=0)
    variances = np.concatenate((np.diag(model.noise), model.disturbance_variance))

    def evidence(variances: np.ndarray) -> float:
        noise, disturbance = np.split(variances, [len(model.noise)])
        other = replace(model, noise=np.diag(noise), disturbance_variance=disturbance)
        return regress(other.filter(), np.zeros(2), np.ones(2)).log_evidence

    for i, unit in enumerate(np.eye(len(variances))):
        slope = (evidence(variances + small * unit) - evidence(variances - small * unit)) / (2.0 * small)
        assert slope == pytest.approx(0.5 * (squares - information)[i], abs=1e-6)


def test_an_unknown_start_costs_no_digits() -> None:
    """A start a million times as uncertain as all else leaves states the digits that a huge covariance would eat."""
    steps, h, rng = 300, 0.1, np.random.default_rng(5)
    through = np.array([[1.0, h], [-h, 1.0 - 0.01 * h]])
    model = LinearGaussian(
        observed=np.sin(h * np.arange(steps))[:, None] + 1e-3 * rng.normal(size=(steps, 1)),
        offset=np.zeros((steps, 3)),
        state=np.broadcast_to(np.vstack(([1.0, 0.0], through)), (steps, 3, 2)),
        disturbance=np.broadcast_to(np.array([[0.0], [h * h / 2.0], [h]]), (steps, 3, 1)),
        coefficient=np.zeros((steps, 3, 2)),
        disturbance_variance=np.array([1e-10]),
        noise=np.diag([1e-6, 0.0, 0.0]),
        initial=1e6 * np.eye(2),
    )
    first = model.filter()
    found = regress(first, np.zeros(2), np.ones(2))
    states, _ = first.smooth(found.change)
    # Smoothing what is left changes nothing more.
    second = replace(model, observed=model.observed - states[:, :1], offset=residual_offset(model, states)).filter()
    change = regress(second, found.change, np.ones(2))
    assert np.abs(second.smooth(change.change)[0]).max() < 1e-9 * np.abs(states).max()


def residual_offset(model: LinearGaussian, states: np.ndarray) -> np.ndarray:
    offset = np.zeros_like(model.offset)
    offset[:-1, 1:] = np.einsum("kij,kj->ki", model.state[:-1, 1:], states[:-1]) - states[1:]
    return offset


def test_a_model_that_grows_keeps_its_covariances() -> None:
    """Negative damping, which a wrong parameter may be: the skew part of rounding must not grow with the motion."""
    steps, step = 6000, np.array([[1.0, 0.1], [-0.1, 1.02]])
    state = np.tile(np.vstack((np.eye(2), step)), (steps, 1, 1))
    disturbance = np.tile(np.array([[0.0], [0.0], [0.0], [0.1]]), (steps, 1, 1))
    model = LinearGaussian(
        np.zeros((steps, 2)), np.zeros((steps, 4)), state, disturbance, np.zeros((steps, 4, 0)), np.ones(1),
        np.diag([1e-4, 1e-4, 0.0, 0.0]), np.zeros((2, 0)),
    )  # fmt: skip
    covariance = model.filter().covariance[2:]  # from when both states have been moved
    np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    np.testing.assert_allclose(covariance[-1], covariance[1000], rtol=1e-6)
