"""What bounds leave of a Gaussian: its mean, covariance and intervals, by expectation propagation (Minka 2001).

Each bound is one coordinate's own: it cuts off what lies below, and moves the others as far as they are correlated.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erfcx, log_ndtr, ndtri_exp

# Sweeps over the bounds at most, and the change of the mean, in standard deviations, below which they have settled.
SWEEPS, SETTLED = 100, 1e-10
# Standard deviations beyond which the moments of a tail are those of its asymptotic series: the closed form cancels.
FAR_TAIL = 100.0


class TruncatedGaussian:
    """A Gaussian of p coordinates x, given that x >= lower.

    With one bound the moments are exact. With several they are good to about a hundredth of a standard deviation in
    the mean, and to a few per cent in the standard deviation where the coordinates are strongly correlated.

    Args:
        peak: (p,), where the Gaussian itself is greatest.
        covariance: (p, p), its own.
        lower: (p,), least values; -inf without one.

    Attributes:
        mean: (p,), of what is left.
        covariance: (p, p), of what is left.
    """

    def __init__(self, peak: np.ndarray, covariance: np.ndarray, lower: np.ndarray) -> None:
        self.mean, self.covariance, self.lower = peak.copy(), covariance.copy(), lower
        # Gaussians that stand for the bounds: precision, and precision times mean.
        self._precision, self._shift = np.zeros(len(peak)), np.zeros(len(peak))
        tolerance = SETTLED * np.sqrt(np.diag(covariance))
        bounded = np.flatnonzero(np.isfinite(lower))
        for _ in range(SWEEPS if len(bounded) else 0):
            before = self.mean.copy()
            for i in bounded:
                self._renew(int(i))
            if np.all(np.abs(self.mean - before) <= tolerance):
                break

    def marginals(
        self, probabilities: tuple[float, float], error: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Every coordinate by itself: standard deviations (p,), and the quantiles (2, p) at two probabilities.

        Args:
            probabilities: Of the two quantiles.
            error: (p,), standard deviation of what else each coordinate may be off by, independently of the others;
                what is left of the two together is still not below the bound.
        """
        without = [self._without(i) for i in range(len(self.mean))]
        center = np.array([mean for mean, _ in without])
        spread = np.sqrt(np.array([variance for _, variance in without]) + np.square(error))
        cut = (self.lower - center) / spread
        share = np.array([tail_moments(c)[1] for c in cut])
        # In logarithms, so that a bound far out in the tail is no trouble.
        beyond = [-ndtri_exp(np.log1p(-probability) + log_ndtr(-cut)) for probability in probabilities]
        return spread * np.sqrt(share), center + spread * np.stack(beyond)

    def _without(self, i: int) -> tuple[float, float]:
        """Mean and variance of a coordinate given every bound but its own."""
        variance = 1.0 / (1.0 / self.covariance[i, i] - self._precision[i])
        return variance * (self.mean[i] / self.covariance[i, i] - self._shift[i]), variance

    def _renew(self, i: int) -> None:
        """Replace the Gaussian that stands for a coordinate's bound by the one that gives it the right moments."""
        center, variance = self._without(i)
        spread = np.sqrt(variance)
        mean, share = tail_moments((self.lower[i] - center) / spread)
        precision = (1.0 / share - 1.0) / variance
        shift = (center + spread * mean) / (share * variance) - center / variance
        more, pull = precision - self._precision[i], shift - self._shift[i]
        column = self.covariance[:, i] / (1.0 + more * self.covariance[i, i])
        self.mean = self.mean + column * (pull - more * self.mean[i])
        self.covariance = self.covariance - more * np.outer(column, self.covariance[i])
        self._precision[i], self._shift[i] = precision, shift


def tail_moments(cut: float) -> tuple[float, float]:
    """Mean and variance of a standard Gaussian given that it is at least ``cut``, which may be -inf."""
    if np.isinf(cut):
        return 0.0, 1.0
    if cut > FAR_TAIL:
        return cut + 1.0 / cut - 2.0 / cut**3, 1.0 / cut**2 - 6.0 / cut**4
    mean = np.sqrt(2.0 / np.pi) / erfcx(cut / np.sqrt(2.0))
    return float(mean), float(1.0 - mean * (mean - cut))
