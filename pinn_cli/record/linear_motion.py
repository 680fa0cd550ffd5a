"""The motion of a linear structure, exactly: mode by mode, from sample to sample.

Each mode of a linear structure (:mod:`pinn_cli.system.modes`) is an equation by itself, z' = lambda z + g, so

    z(t + h) = e^(lambda h) z(t) + int_0^h e^(lambda (h - s)) g(t + s) ds.

The load g of a step is the polynomial through its values at Gauss's points, and the integral of that is exact, however
fast or damped the mode is: no step is too long, and no structure too stiff.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

if TYPE_CHECKING:
    from pinn_cli.system.modes import Modes

# Histories, from times (M,), s, to (M, L), and what a unit of each does to the coordinates' accelerations, (L, n).
Push = tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]

# Points of a step: a polynomial through eight follows a sine at the Nyquist frequency to 1e-5.
POINTS = 8
# Steps whose loads stand in memory at a time.
CHUNK = 2048
# What modes may miss of the structure that they are of. Motions that share one shape and one pole, as that of a body
# that nothing holds, have no modes.
COMPLETE = 1e-7


def has_modes(modes: Modes) -> bool:
    """Whether the structure's motion is the sum of its modes': at time 0 they give back the state that they are of."""
    n, identity = len(modes.m), np.eye(len(modes.m))
    left = np.hstack((modes.vectors @ modes.inputs, (modes.vectors * modes.poles) @ modes.inputs - identity))
    return bool(np.isfinite(left).all() and np.abs(left).max(initial=0.0) < COMPLETE * n)


def linear_motion(
    modes: Modes, pushes: Sequence[Push], time: np.ndarray, start: Sequence[np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of the coordinates at all samples, (N, n) each; not finite where they overflow.

    Args:
        modes: Of the structure.
        pushes: What acts.
        time: (N,), s, even.
        start: Displacement and velocity (n,) at the first sample; None: rest.
    """
    u, v = (np.zeros(len(modes.m)),) * 2 if start is None else (np.asarray(x, dtype=float) for x in start)
    begins = modes.poles * (modes.inputs @ u) + modes.inputs @ ((modes.C @ u) / modes.m + v)
    upper = np.flatnonzero(modes.poles.imag >= 0.0)  # the others are their conjugates
    poles, step = modes.poles[upper], (time[-1] - time[0]) / (len(time) - 1)
    points = 0.5 + 0.5 * np.polynomial.legendre.leggauss(POINTS)[0]
    weights, inputs = step * _weights(poles * step, points), modes.inputs[upper].T
    out = np.empty((len(time), len(upper)), complex)
    out[0] = begins[upper]
    with np.errstate(over="ignore", invalid="ignore"):
        through = np.exp(poles * step)
        for first in range(0, len(time) - 1, CHUNK):
            stop = min(first + CHUNK, len(time) - 1)
            at = (time[first:stop, None] + step * points).reshape(-1)
            pushed = np.zeros((stop - first, len(upper)), complex)
            for history, influence in pushes:
                values = history(at)
                acting = values.any(axis=0)
                of_values = weights[:, None] * (influence[acting] @ inputs)
                columns = values[:, acting].reshape(stop - first, POINTS * int(acting.sum()))
                pushed += columns @ of_values.reshape(-1, len(upper))
            for j, factor in enumerate(through):
                before = np.array([factor * out[first, j]])
                out[first + 1 : stop + 1, j], _ = lfilter([1.0], [1.0, -factor], pushed[:, j], zi=before)
        shapes = modes.vectors[:, upper] * np.where(poles.imag > 0.0, 2.0, 1.0)
        return _real_part(out, shapes), _real_part(out, shapes * poles)


def _real_part(z: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    return np.asarray(z.real @ shapes.real.T - z.imag @ shapes.imag.T)


def _weights(z: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, J), by which values at points (P,) of a step, from 0 to 1, count in int_0^1 e^(z (1 - s)) g(s) ds; z (J,).

    The integrals of s^p / p! are the first row of an exponential (Van Loan 1978), for any z.
    """
    count = len(points)
    chain = np.zeros((len(z), count + 1, count + 1), complex)
    chain[:, 0, 0] = z
    chain[:, np.arange(count), np.arange(1, count + 1)] = 1.0
    integrals = expm(chain)[:, 0, 1:]
    factorial = np.cumprod(np.maximum(np.arange(count), 1.0))
    powers = points[:, None] ** np.arange(count) / factorial
    return np.asarray(np.linalg.solve(powers.T, integrals.T))
