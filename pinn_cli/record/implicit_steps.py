"""Time integration where the equation of motion is stiff: LSODA, which takes implicit steps where they may be longer.

Friction that sticks holds a mass like an enormous damper: Runge-Kutta stays stable with hundreds of steps per sample
only. An implicit method (Petzold, SIAM J. Sci. Stat. Comput. 4, 1983, in scipy) takes some ten.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import odeint

from pinn_cli.record.steps import TooStiffError

if TYPE_CHECKING:
    from pinn_cli.record.runge_kutta import Force, Slope

# Error of a step, over the state and over what the loads make of it within a sample.
TOLERANCE = 1e-7
# Slopes that are taken per sample of what is behind, with so many samples in advance. Sticking friction takes 10 to 25.
MOST_SLOPES, IN_ADVANCE = 400, 50
# Implicit steps of LSODA between two samples: no bound, `MOST_SLOPES` is one.
ANY_NUMBER = 10**6


def implicit_steps(
    slope: Slope, force: Force, time: np.ndarray, sampled: np.ndarray, hold: str, start: np.ndarray, coordinates: int
) -> np.ndarray:
    """The states at all samples (N, ...); not finite from where on the state is not.

    Args:
        slope: Of a state under a load.
        force: Load at any times.
        time: (N,), s.
        sampled: (N, ...), the load at those.
        hold: ``exact`` or ``zero_order``.
        start: The state at the first time: displacements, velocities, hidden forces.
        coordinates: n, as many displacements and velocities.

    Raises:
        TooStiffError: It takes more than `MOST_SLOPES` slopes per sample.
    """
    step, shape, taken = float(time[1] - time[0]), start.shape, 0
    states = np.full((len(time), start.size), np.nan)
    states[0] = start.ravel()

    def rate(y: np.ndarray, t: float, held: np.ndarray | None) -> np.ndarray:
        nonlocal taken
        taken += 1
        if taken > MOST_SLOPES * ((t - time[0]) / step + IN_ADVANCE):
            raise TooStiffError(f"it takes more than {MOST_SLOPES} evaluations per sample, by implicit steps too")
        return slope(y.reshape(shape), force(np.array([t]))[0] if held is None else held).ravel()

    size = _size(lambda y, load: slope(y.reshape(shape), load).ravel(), sampled, start.ravel(), step, coordinates)
    options = {"rtol": TOLERANCE, "atol": TOLERANCE * size}
    parts = [(0, len(time), None)] if hold == "exact" else [(k, k + 2, sampled[k]) for k in range(len(time) - 1)]
    for begin, end, held in parts:
        at = time[begin:end]
        found, told = odeint(
            rate, states[begin], at, (held,), full_output=True, hmax=step, mxstep=ANY_NUMBER, **options
        )  # fmt: skip
        reached = len(at) if told["message"] == "Integration successful." else 1
        states[begin + 1 : begin + reached] = found[1:reached]
        if reached == 1:
            break
    return states.reshape(-1, *shape)


def _size(slope: Slope, sampled: np.ndarray, start: np.ndarray, step: float, coordinates: int) -> np.ndarray:
    """(states,), what the loads make of displacements, of velocities and of hidden forces within a sample, at most.

    They make velocities at their rates from the start, and all else at the rates that follow from these.
    """
    first = start + step * np.array([slope(start, load) for load in sampled])
    moved = start + step * np.array([slope(*each) for each in zip(first, sampled, strict=True)])
    most, out = np.abs(np.concatenate((first, moved))).max(axis=0), np.empty(len(start))
    for part in (slice(coordinates), slice(coordinates, 2 * coordinates), slice(2 * coordinates, None)):
        out[part] = max(most[part].max(initial=0.0), np.finfo(float).tiny)
    return out
