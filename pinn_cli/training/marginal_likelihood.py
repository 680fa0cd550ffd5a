"""Likelihood of the parameters with the motion integrated out: how well the states are known is part of it."""

from __future__ import annotations

import numpy as np

from pinn_cli.training.likelihood import ParameterLikelihood

# Half-width of the tabulated range of s, in its standard deviations, and the number of points in it: over one to two
# per cent of the noise everything is smooth.
S_RANGE, S_POINTS = 6.0, 5


class MarginalLikelihood(ParameterLikelihood):
    """log p(record | theta, s) = level(s) - (theta - peak(s))^T precision(s) (theta - peak(s)) / 2.

    The readout weights are integrated out by Laplace's method about the most probable motion: the precision is the
    Schur complement of the joint Gauss-Newton Hessian. Level, peak and precision are polynomials through their values
    at a few s.

    Args:
        names: See :class:`ParameterLikelihood`.
        sigma_force: Likewise.
        s: (G,), about 0; a single one where no force is measured, and nothing depends on s.
        level: (G,).
        peak: (G, p).
        precision: (G, p, p), symmetric, not negative.
        s_std: See :class:`ParameterLikelihood`.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        sigma_force: np.ndarray,
        s: np.ndarray,
        level: np.ndarray,
        peak: np.ndarray,
        precision: np.ndarray,
        s_std: float,
    ) -> None:
        self.names, self.sigma_force, self.s_std = names, sigma_force, s_std
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
        # Beyond the table only its width is known: a Gaussian of the standard deviation of s goes on from its ends.
        beyond = s - within  # exactly zero within: inside * reach is not, by rounding
        if beyond:
            by_s = -beyond / self.s_std**2
            value += 0.5 * by_s * beyond
        return value, -pull, by_s
