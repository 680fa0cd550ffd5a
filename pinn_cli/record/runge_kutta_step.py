"""One step of the classical Runge-Kutta method of order four."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Slope = Callable[[np.ndarray, np.ndarray], np.ndarray]


def runge_kutta_step(
    slope: Slope, z: np.ndarray, left: np.ndarray, middle: np.ndarray, right: np.ndarray, step: float
) -> np.ndarray:
    """Displacement and velocity z (2, ..., ndof) a ``step`` (s) later, by the classical method of order four.

    ``left``, ``middle`` and ``right`` are the forces (..., ndof) at the step's beginning, middle and end, N.
    """
    k1 = slope(z, left)
    k2 = slope(z + (0.5 * step) * k1, middle)
    k3 = slope(z + (0.5 * step) * k2, middle)
    k4 = slope(z + step * k3, right)
    return z + (step / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
