"""Whether a residual is white: its autocorrelation, and its cumulated periodogram against that of white noise.

The test is Bartlett's (1955; Priestley 1981, section 6.2.6): of N samples of Gaussian white noise the cumulated
periodogram rises as the distribution function of uniform numbers does, so its distance from the straight line has the
distribution of Kolmogorov and Smirnov. It looks at all lags at once and has no number of lags to choose.

Residuals of an estimate are never quite white: the estimate has taken in the noise of its own band. With K effective
parameters in N samples the distance is about K / N. So the size of a deviation counts as well as its probability.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import kstwo


def autocorrelation(values: np.ndarray, lags: int) -> np.ndarray:
    """(lags,) autocorrelation of values (N,) about their mean at lags 1 to ``lags``; NaN where they are constant.

    Divided by N at every lag, so that it dies out with the overlap; beyond N - 1 it is 0.
    """
    centred = values - values.mean()
    power = float(centred @ centred)
    if not power > 0.0:
        return np.full(lags, np.nan)
    return np.array([centred[lag:] @ centred[: max(len(centred) - lag, 0)] / power for lag in range(1, lags + 1)])


def cumulated_periodogram(values: np.ndarray) -> np.ndarray:
    """(m,) share of the power of values (N,) up to each frequency j / N, j = 1 to m, below Nyquist's; NaN of none."""
    power = np.abs(np.fft.rfft(values - values.mean())[1 : (len(values) + 1) // 2]) ** 2
    total = power.sum()
    shares: np.ndarray = np.cumsum(power) / total if total > 0.0 else np.full(len(power), np.nan)
    return shares


def cumulated_deviation(values: np.ndarray) -> float:
    """Largest distance of the cumulated periodogram of values (N,) from white noise's straight line, 0 to 1."""
    shares = cumulated_periodogram(values)[:-1]
    rank = np.arange(len(shares) + 1) / len(shares)
    return float(np.max(np.maximum(rank[1:] - shares, shares - rank[:-1])))


def white_probability(values: np.ndarray) -> float:
    """The probability that white noise of as many samples deviates further than values (N,) do; NaN where constant."""
    deviation = cumulated_deviation(values)
    shares = (len(values) + 1) // 2 - 2
    return float(kstwo.sf(deviation, shares)) if np.isfinite(deviation) else np.nan
