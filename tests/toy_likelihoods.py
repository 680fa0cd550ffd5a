"""Likelihoods of parameters whose posteriors are known in closed form."""

from collections.abc import Sequence

import numpy as np

from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihood


class GaussianLikelihood(ParameterLikelihood):
    """theta ~ N(peak, covariance) and, apart from it, s ~ N(0, s_std^2)."""

    def __init__(
        self,
        peak: Sequence[float],
        covariance: np.ndarray | Sequence[Sequence[float]],
        names: Sequence[str] = (),
        sigma_force: Sequence[float] = (0.1, np.nan),
        s_std: float = 0.02,
    ) -> None:
        self.peak = np.array(peak, dtype=float)
        self.covariance = np.array(covariance, dtype=float)
        self.curvature = np.linalg.inv(self.covariance)
        self.names = tuple(names) or tuple(f"k_{i + 1}" for i in range(len(self.peak)))
        self.sigma_force, self.s_std = np.array(sigma_force), s_std

    def evaluate(self, theta: np.ndarray, s: float) -> tuple[float, np.ndarray, float]:
        pull = self.curvature @ (theta - self.peak)
        value = -0.5 * float((theta - self.peak) @ pull) - 0.5 * (s / self.s_std) ** 2
        return value, -pull, -s / self.s_std**2


class RegressionLikelihood(GaussianLikelihood):
    """That of linear regression: N residuals whose scale exp(s) is unknown, so that theta and s depend."""

    count = 500

    def evaluate(self, theta: np.ndarray, s: float) -> tuple[float, np.ndarray, float]:
        pull = self.curvature @ (theta - self.peak)
        misfit, weight = self.count + float((theta - self.peak) @ pull), np.exp(-2 * s)
        return -0.5 * weight * misfit - self.count * s, -weight * pull, weight * misfit - self.count


class Everywhere(GaussianLikelihood):
    """A record that says nothing about theta: the posterior is the prior."""

    def __init__(self, count: int = 1) -> None:
        super().__init__(np.full(count, np.nan), np.eye(count))
        self.curvature = np.zeros((count, count))

    def evaluate(self, theta: np.ndarray, s: float) -> tuple[float, np.ndarray, float]:
        return -0.5 * (s / self.s_std) ** 2, np.zeros(len(theta)), -s / self.s_std**2


def correlated(std: Sequence[float], correlation: float) -> np.ndarray:
    """Covariance with the same correlation between all pairs."""
    count = len(std)
    return np.outer(std, std) * (correlation * np.ones((count, count)) + (1 - correlation) * np.eye(count))


def slopes(function, at: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Central differences of a function, a row for each step."""
    return np.array([(function(at + h) - function(at - h)) / (2 * h.sum()) for h in np.diag(steps)])
