"""Likelihood of the parameters with the motion integrated out: how well the states are known is part of it."""

from __future__ import annotations

import numpy as np

from pinn_cli.training.likelihood import ParameterLikelihood

# Half-width of the tabulated range of s, in its standard deviations and at most, and the number of points in it:
# parameters follow s smoothly, and little.
S_RANGE, S_REACH, S_POINTS = 6.0, 0.6, 5


class MarginalLikelihood(ParameterLikelihood):
    """log p(record | theta, s) = level(s) - away^T precision(s) away / 2 + log N(s), with away = theta - peak(s).

    The readout weights are integrated out by Laplace's method about the most probable motion: the precision is the
    Schur complement of the joint Gauss-Newton Hessian. Level, peak and precision are polynomials through their values
    at a few s, and beyond those what they are at the nearest. N is what the residuals say of the noise by themselves.

    Args:
        names: See :class:`ParameterLikelihood`.
        sigma_force: Likewise.
        s: (G,), about 0; a single one where no force is measured, and nothing depends on s.
        level: (G,).
        peak: (G, p).
        precision: (G, p, p), symmetric, not negative.
        s_told: Mean and standard deviation of N, a Gaussian.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        sigma_force: np.ndarray,
        s: np.ndarray,
        level: np.ndarray,
        peak: np.ndarray,
        precision: np.ndarray,
        s_told: tuple[float, float],
    ) -> None:
        self.names, self.sigma_force = names, sigma_force
        self.s_mean, self.s_std = s_told
        self.reach = float(np.max(np.abs(s))) or 1.0
        powers = np.vander(s / self.reach, increasing=True)
        solve = np.linalg.inv(powers)
        self._level, self._peak = solve @ level, solve @ peak
        self._precision = np.tensordot(solve, precision, 1)
        self.peak, self.curvature = self._peak[0], self._precision[0]

    def evaluate(self, theta: np.ndarray, s: float) -> tuple[float, np.ndarray, float]:
        """See :meth:`ParameterLikelihood.evaluate`."""
        within = min(max(s, -self.reach), self.reach)
        inside = within / self.reach
        order = np.arange(len(self._level))
        powers = inside**order
        slopes = order * inside ** np.maximum(order - 1, 0) / self.reach
        away = theta - powers @ self._peak
        pull = np.tensordot(powers, self._precision, 1) @ away
        value = float(powers @ self._level - 0.5 * away @ pull)
        turn = np.tensordot(slopes, self._precision, 1) @ away
        by_s = float(slopes @ self._level + pull @ (slopes @ self._peak) - 0.5 * away @ turn)
        if s != within:
            by_s = 0.0
        if len(order) > 1:
            off = (s - self.s_mean) / self.s_std
            value, by_s = value - 0.5 * off**2, by_s - off / self.s_std
        return value, -pull, by_s
