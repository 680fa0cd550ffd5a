"""Time integration by the classical Runge-Kutta method of order four."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pinn_cli.record.corners import Corners
from pinn_cli.record.multiple_shooting import MANY_STEPS, shot
from pinn_cli.record.runge_kutta_step import Slope, runge_kutta_step

Force = Callable[[np.ndarray], np.ndarray]


def runge_kutta(
    slope: Slope,
    force: Force,
    time: np.ndarray,
    sampled: np.ndarray,
    hold: str,
    substeps: int,
    start: np.ndarray,
    corners: Corners | None,
) -> np.ndarray:
    """The states at all samples (N, ...), by ``substeps`` steps per sample.

    Args:
        slope: Of a state under a load.
        force: Load at any times.
        time: (N,), s.
        sampled: (N, ...), the load at those.
        hold: ``exact`` or ``zero_order``.
        substeps: Steps per sample.
        start: The state at the first time.
        corners: Of the laws; steps across one are divided. None: all laws are smooth.
    """
    h = (time[-1] - time[0]) / ((len(time) - 1) * substeps)
    steps = (len(time) - 1) * substeps
    if hold == "exact":
        starts = time[0] + h * np.arange(steps + 1)
        left = force(starts)
        left, middle, right = left[:-1], force(starts[:-1] + 0.5 * h), left[1:]
    else:
        left = middle = right = np.repeat(sampled[:-1], substeps, axis=0)
    if corners is None and steps >= MANY_STEPS and start.ndim == 2 == left.ndim:
        found = shot(slope, start, (left, middle, right), h)
        if found is not None:
            return found[::substeps]
    z = start
    states = np.empty((steps + 1, *z.shape))
    states[0] = z
    for step, (f0, f1, f2) in enumerate(zip(left, middle, right, strict=True)):
        after = runge_kutta_step(slope, z, f0, f1, f2, h)
        if corners is not None and corners.cuts(z, after, corners.shortest, (f0, f2)).size:
            at = force if hold == "exact" else _held(f0)
            after = _in_parts(slope, at, corners, z, time[0] + h * step, h)
        z = after
        states[step + 1] = z
    return states[::substeps]


def _held(load: np.ndarray) -> Force:
    return lambda time: np.broadcast_to(load, (len(time), *load.shape))


def _in_parts(slope: Slope, force: Force, corners: Corners, z: np.ndarray, begin: float, step: float) -> np.ndarray:
    """The state at the end of a step, from z at its beginning, taken in parts; a part across a corner is divided."""
    shortest = corners.shortest * step
    at, ahead = begin, [begin + step]  # the ends of the parts to come, the next one last
    while ahead:
        part = ahead[-1] - at
        left, middle, right = force(at + part * np.array([0.0, 0.5, 1.0]))
        after = runge_kutta_step(slope, z, left, middle, right, part)
        cuts = corners.cuts(z, after, shortest / part, (left, right)) if part > 2.0 * shortest else np.zeros(0)
        if cuts.size:
            ahead.extend(at + part * cuts[::-1])
        else:
            z, at = after, ahead.pop()
    return z
