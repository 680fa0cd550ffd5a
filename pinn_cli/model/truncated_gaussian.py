"""What bounds leave of a Gaussian: its mean, covariance and intervals, by expectation propagation (Minka 2001).

Each bound is one coordinate's own: it cuts off what lies below, and moves the others as far as they are correlated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import erfcx, log_ndtr, ndtri_exp

# Sweeps over the bounds at most, and the change of the mean, in standard deviations, below which they have settled.
SWEEPS, MEAN_SETTLED = 100, 1e-10
# Share of a precision or a variance that must be left by a subtraction for its digits to mean something.
CANCELLED = 1e-8
# Standard deviations beyond which the moments of a tail are those of its asymptotic series: the closed form cancels.
FAR_TAIL = 100.0


class Marginals(NamedTuple):
    """Every coordinate by itself.

    Attributes:
        mean: (p,).
        std: (p,), standard deviations.
        quantiles: (2, p), at the two probabilities asked for.
    """

    mean: np.ndarray
    std: np.ndarray
    quantiles: np.ndarray


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
        self._peak, self._uncut = peak, covariance
        # Gaussians that stand for the bounds: precision, and precision times mean.
        self._precision, self._shift = np.zeros(len(peak)), np.zeros(len(peak))
        tolerance = MEAN_SETTLED * np.sqrt(np.diag(covariance))
        bounded = np.flatnonzero(np.isfinite(lower))
        for _ in range(SWEEPS if len(bounded) else 0):
            before = self.mean.copy()
            for i in bounded:
                self._renew(int(i))
            if np.all(np.abs(self.mean - before) <= tolerance):
                break

    def marginals(self, probabilities: tuple[float, float], error: np.ndarray | float = 0.0) -> Marginals:
        """Mean, standard deviation and two quantiles of every coordinate by itself.

        The mean is the quantile at 50 % without a bound and at 63 % far out in a tail, so it always lies between those
        at 5 and 95 %.

        Args:
            probabilities: Of the two quantiles.
            error: (p,), standard deviation of what else each coordinate may be off by, independently of the others;
                what is left of the two together is still not below the bound.
        """
        without = [self._without(i) for i in range(len(self.mean))]
        center = np.array([mean for mean, _ in without])
        spread = np.sqrt(np.array([variance for _, variance in without]) + np.square(error))
        cut = (self.lower - center) / spread
        mean, share = np.array([tail_moments(c) for c in cut]).reshape(-1, 2).T
        # In logarithms, so that a bound far out in the tail is no trouble.
        beyond = [-ndtri_exp(np.log1p(-probability) + log_ndtr(-cut)) for probability in probabilities]
        values = center + spread * np.stack((mean, *beyond))
        # Further out still the centre is so far away that it rounds off what lies above the bound.
        values = np.where(cut > FAR_TAIL, self.lower + spread * _above_far_cut(cut, probabilities), values)
        return Marginals(values[0], spread * np.sqrt(share), values[1:])

    def _without(self, i: int) -> tuple[float, float]:
        """Mean and variance of a coordinate given every bound but its own."""
        precision = 1.0 / self.covariance[i, i]
        if not precision - self._precision[i] > CANCELLED * precision:
            return self._without_anew(i)
        variance = 1.0 / (precision - self._precision[i])
        return variance * (self.mean[i] / self.covariance[i, i] - self._shift[i]), variance

    def _without_anew(self, i: int) -> tuple[float, float]:
        """The same from the Gaussian itself, where a bound in the far tail leaves no digits to take it back out.

        Rasmussen and Williams (2006), equation 3.68, in which no large numbers are subtracted.
        """
        others = np.flatnonzero(self._precision > 0.0)
        others = others[others != i]
        root, across = np.sqrt(self._precision[others]), self._uncut[i, others]
        inner = np.eye(len(others)) + root[:, None] * self._uncut[np.ix_(others, others)] * root
        solved = np.linalg.solve(inner, root * across)
        variance = float(self._uncut[i, i] - solved @ (root * across))
        if not variance > CANCELLED * self._uncut[i, i]:
            return float(self._peak[i]), float(self._uncut[i, i])  # bounds that contradict each other: by itself
        return float(self._peak[i] + solved @ (self._shift[others] / root - root * self._peak[others])), variance

    def _renew(self, i: int) -> None:
        """Replace the Gaussian that stands for a coordinate's bound by the one that gives it the right moments."""
        center, variance = self._without(i)
        spread = np.sqrt(variance)
        mean, share = tail_moments((self.lower[i] - center) / spread)
        precision = (1.0 / share - 1.0) / variance
        shift = (center + spread * mean) / (share * variance) - center / variance
        more, pull = precision - self._precision[i], shift - self._shift[i]
        column = self.covariance[:, i] * (variance * share / self.covariance[i, i])
        self.mean = self.mean + column * (pull - more * self.mean[i])
        self.covariance = self.covariance - more * np.outer(column, self.covariance[i])
        self.covariance[i], self.covariance[:, i] = column, column  # what this is, without rounding
        self._precision[i], self._shift[i] = precision, shift


def tail_moments(cut: float) -> tuple[float, float]:
    """Mean and variance of a standard Gaussian given that it is at least ``cut``, which may be -inf."""
    if np.isinf(cut):
        return 0.0, 1.0
    if cut > FAR_TAIL:
        return cut + 1.0 / cut - 2.0 / cut**3, 1.0 / cut**2 - 6.0 / cut**4
    mean = np.sqrt(2.0 / np.pi) / erfcx(cut / np.sqrt(2.0))
    return float(mean), float(1.0 - mean * (mean - cut))


def _above_far_cut(cut: np.ndarray, probabilities: tuple[float, float]) -> np.ndarray:
    """(3, p) mean and two quantiles of a standard Gaussian's tail, counted from its cut, where that is > `FAR_TAIL`.

    The density above the cut c is exp(-c t - t^2 / 2) but for 1 / c^2 of it.
    """
    cut = np.maximum(cut, FAR_TAIL)
    ranks = [-np.log1p(-probability) for probability in probabilities]
    return np.stack([1.0 / cut - 2.0 / cut**3, *(2.0 * rank / (cut + np.sqrt(cut**2 + 2.0 * rank)) for rank in ranks)])
