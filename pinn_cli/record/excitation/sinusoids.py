"""Sums of sinusoids, which are known at every time."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.fft import ifft

# Times and sinusoids from which on evenly spaced times are left to a Fourier transform, and how far from even they may
# be, in steps.
MANY_TERMS, UNEVEN = 30_000_000, 1e-6


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
    if len(time) * len(bins) >= MANY_TERMS:
        steps = _steps_in_a_period(time, period)
        if steps > bins[-1]:
            spectrum = np.zeros((steps, coefficients.shape[1]), dtype=np.complex128)
            spectrum[bins] = coefficients * np.exp(turn * time[0] * bins)[:, None]
            whole: np.ndarray = np.real(ifft(spectrum, axis=0, norm="forward"))
            return whole[np.arange(len(time)) % steps]
    if len(time) < len(bins):
        return np.real(np.exp(turn * np.outer(time, bins)) @ coefficients)
    w = np.exp(turn * time)
    signals: np.ndarray = np.real(polyval(w, coefficients) * w ** bins[0]).T
    return signals


def _steps_in_a_period(time: np.ndarray, period: float) -> int:
    """How many evenly spaced times fill the period; 0 where they are uneven, or do not fill it."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    steps = round(period / step)
    even = np.abs(time - (time[0] + step * np.arange(len(time)))).max() <= UNEVEN * step
    return steps if even and abs(period / step - steps) <= UNEVEN else 0
