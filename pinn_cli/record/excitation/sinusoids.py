"""Sums of sinusoids, which are known at every time."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyval


def sum_of_sinusoids(time: np.ndarray, period: float, bins: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Re sum_k c_k exp(2 pi i k t / P), (M, columns).

    Args:
        time: (M,), s.
        period: P, s.
        bins: (K,), whole numbers k, one after the other without gaps.
        coefficients: (K, columns), complex: amplitude and phase.
    """
    # With w = exp(2 pi i t / P) the sum is the real part of a polynomial in w. Horner's scheme needs no array of
    # (time, bins) and takes a tenth of the cosines' time, but loops over the bins: at few times, form the powers.
    turn = 2j * np.pi / period
    if len(time) < len(bins):
        return np.real(np.exp(turn * np.outer(time, bins)) @ coefficients)
    w = np.exp(turn * time)
    signals: np.ndarray = np.real(polyval(w, coefficients) * w ** bins[0]).T
    return signals
