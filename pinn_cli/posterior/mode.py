"""The peak of a density and its curvature there, from the density's gradient alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pinn_cli.settings.errors import DivergenceError

# x (d,) to the logarithm of a density and its gradient (d,).
LogDensity = Callable[[np.ndarray], tuple[float, np.ndarray]]

ITERATIONS = 200
# Half of what a Newton step would still gain in the log density; draws differ by order 1.
CONVERGED = 1e-12
# Longest Newton step, in units of the parameters' scales: an exponential's curvature says nothing about places far off.
LONGEST = 30.0
# Curvature along a direction that the density does not care about, relative to the others'.
FLAT = 1e-10


def find_mode(log_density: LogDensity, start: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Damped Newton steps uphill.

    Args:
        log_density: The density.
        start: (d,), where it is finite.
        scale: (d,), order of magnitude of the density's width along each axis, the others held.

    Returns:
        The mode (d,), and minus the Hessian there (d, d), made positive definite.

    Raises:
        DivergenceError: The density is not finite at the start.
    """
    x = np.array(start, dtype=float)
    value, gradient = log_density(x)
    if not np.isfinite(value):
        raise DivergenceError(
            f"the posterior cannot be evaluated at its start, {np.array2string(x, precision=4)} (logarithms of "
            "parameters that are positive, and of the noise): is a prior far from all that the record allows?"
        )
    for _ in range(ITERATIONS):
        precision = curvature(log_density, x, scale)
        step = np.linalg.solve(precision, gradient)
        gain = 0.5 * float(step @ gradient)
        if gain < CONVERGED:
            break
        step *= min(1.0, LONGEST / float(np.max(np.abs(step) / scale)))
        moved = _uphill(log_density, x, value, gradient, step)
        if moved is None:
            break
        x, value, gradient = moved
        scale = np.minimum(1 / np.sqrt(np.diag(precision)), LONGEST * scale)
    return x, curvature(log_density, x, scale)


def curvature(log_density: LogDensity, x: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Minus the Hessian (d, d) by central differences of the gradient; negative eigenvalues are turned round."""
    steps = 1e-4 * scale
    rows = [
        (log_density(x - step)[1] - log_density(x + step)[1]) / (2 * size)
        for step, size in zip(np.diag(steps), steps, strict=True)
    ]
    scaled = np.array(rows) * np.outer(scale, scale)
    if not np.isfinite(scaled).all():
        return np.diag(1 / scale**2)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    values = np.maximum(np.abs(values), FLAT * max(1.0, float(np.abs(values).max())))
    return (vectors * values) @ vectors.T / np.outer(scale, scale)


def _uphill(
    log_density: LogDensity, x: np.ndarray, value: float, gradient: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray] | None:
    """The longest of the step, its half, its quarter, ... that gains what its slope promises; None: none does."""
    slope = float(step @ gradient)
    for halvings in range(50):
        length = 0.5**halvings
        there, by_x = log_density(x + length * step)
        if np.isfinite(there) and np.isfinite(by_x).all() and there >= value + 1e-4 * length * slope:
            return x + length * step, there, by_x
    return None
