"""Time integration by the classical Runge-Kutta method of order four: step by step, or a record's pieces at once.

A long record of a smooth structure is cut into pieces that are integrated side by side, each from a state of its own.
Newton's method moves those states until every piece begins where the one before it ends (multiple shooting: Bock and
Plitt 1984; in parallel in time: Gander and Vandewalle 2007). What is found is what one step after the other gives, to
rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.steps import Corners, Force, Slope

# Steps from which on pieces are worth their trouble. Cube of the coordinates, which products of matrices take, over the
# steps that one product stands for, up to which: 10 coordinates over 3 steps take half the time of single steps.
MANY_STEPS, MOST_PRODUCTS = 20_000, 300
# Numbers of all pieces that a step is taken for at once: enough that Python's own time does not count, few enough for
# the caches. Steps of a piece at least: a few periods, in which a cubic spring makes of any start a sensible motion.
AT_ONCE, LEAST_STEPS = 4_000, 128
# Relative change of a state by which derivatives are taken, terms of their series, and how far the fastest motion goes
# in the steps that one series stands for, rad.
CHANGE, TAYLOR, ANGLE = 1e-6, 4, 0.3
# Relative difference of derivatives from one time and piece to another, below which they are alike.
ALIKE_WITHIN = 1e-6
# Pieces meet when they are this close, relative to the largest state; above the other distance, relative to the last
# one, derivatives are taken anew. Rounds at most.
CLOSE, SLOW, PIECE_ROUNDS = 1e-12, 0.2, 30
# Of a move that are tried, until the pieces come closer.
MOVE_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)


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

    Arguments are those of :func:`pinn_cli.record.steps.implicit_steps`. Steps across corners of the laws are divided;
    None: all laws are smooth.
    """
    h = (time[-1] - time[0]) / ((len(time) - 1) * substeps)
    steps = (len(time) - 1) * substeps
    if hold == "exact":
        starts = time[0] + h * np.arange(steps + 1)
        left = force(starts)
        left, middle, right = left[:-1], force(starts[:-1] + 0.5 * h), left[1:]
    else:
        left = middle = right = np.repeat(sampled[:-1], substeps, axis=0)
    if corners is None and steps >= MANY_STEPS and left.ndim == 2 and start.shape == (2 * left.shape[1],):
        followed = shot(slope, start, (left, middle, right), h)
        if followed is not None:
            return followed[::substeps]
    z = start
    states = np.empty((steps + 1, *z.shape))
    states[0] = z
    for step, (f0, f1, f2) in enumerate(zip(left, middle, right, strict=True)):
        after = runge_kutta_step(slope, z, f0, f1, f2, h)
        if corners is not None and corners.cuts(z, after, corners.shortest, (f0, f2)).size:
            at = force if hold == "exact" else lambda times, load=f0: np.broadcast_to(load, (len(times), *load.shape))
            after = _in_parts(slope, at, corners, z, time[0] + h * step, h)
        z = after
        states[step + 1] = z
    return states[::substeps]


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


def runge_kutta_step(
    slope: Slope, z: np.ndarray, left: np.ndarray, middle: np.ndarray, right: np.ndarray, step: float
) -> np.ndarray:
    """The state z (...) a ``step`` (s) later, by the classical method of order four.

    ``left``, ``middle`` and ``right`` are the loads at the step's beginning, middle and end.
    """
    k1 = slope(z, left)
    k2 = slope(z + (0.5 * step) * k1, middle)
    k3 = slope(z + (0.5 * step) * k2, middle)
    k4 = slope(z + step * k3, right)
    return z + (step / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)


def shot(
    slope: Slope, start: np.ndarray, loads: tuple[np.ndarray, np.ndarray, np.ndarray], step: float
) -> np.ndarray | None:
    """The states at the ends of all steps (steps + 1, 2 n), the start included; None where single steps serve better.

    The slope is of states (..., 2 n) under loads (..., n), and smooth; the start is displacement and velocity (2 n,).
    Loads are those at the beginnings, middles and ends of the steps, each (steps, n).
    """
    steps, n = loads[0].shape
    pieces = max(1, min(AT_ONCE // n, steps // LEAST_STEPS))
    length = math.ceil(steps / pieces)
    count = steps // length
    whole = (x[: count * length].reshape(count, length, n).swapaxes(0, 1) for x in loads)
    record = _Pieces(tuple(map(np.ascontiguousarray, whole)), slope, step)
    at = np.zeros((count, 2 * n))
    at[0] = start
    states = record.followed(at)
    derivative, before = None, np.inf
    for _ in range(PIECE_ROUNDS):
        size = np.repeat(np.abs(states).reshape(-1, 2, n).max(axis=(0, 2)) + np.finfo(float).tiny, n)
        gaps = states[-1, :-1] - at[1:]
        distance = _largest(gaps / size)
        if distance <= CLOSE:
            return _joined(record, states, loads)
        if derivative is None or distance > SLOW * before:
            derivative = record.derivative(states, size)
            if derivative is None:
                return None
        move, before = _move(gaps, derivative), distance
        for share in MOVE_SHARES:
            trial = at + share * move
            states = record.followed(trial)
            if _largest((states[-1, :-1] - trial[1:]) / size) < distance:
                break
        else:
            return None
        at = trial
    return None


def _largest(gaps: np.ndarray) -> float:
    """Of the absolute values; infinite where one is no number."""
    largest = float(np.max(np.abs(gaps), initial=0.0))
    return largest if math.isfinite(largest) else math.inf


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of a record, all of one length.

    Loads of their steps' beginnings, middles and ends are (length, count, n) each.
    """

    loads: tuple[np.ndarray, ...]
    slope: Slope
    step: float

    @property
    def count(self) -> int:
        return self.loads[0].shape[1]

    def followed(self, at: np.ndarray) -> np.ndarray:
        """(length + 1, count, 2 n), from the states (count, 2 n) that the pieces begin with."""
        states = np.empty((len(self.loads[0]) + 1, *at.shape))
        states[0] = at
        for i, (left, middle, right) in enumerate(zip(*self.loads, strict=True)):
            states[i + 1] = runge_kutta_step(self.slope, states[i], left, middle, right, self.step)
        return states

    def derivative(self, states: np.ndarray, size: np.ndarray) -> np.ndarray | None:
        """(count, 2 n, 2 n), of the states that the pieces end with by those that they begin with, nearly.

        The equation linearised half-way through every few steps is followed by Taylor's series. What that is off makes
        another round, and no error. A linear equation is the same everywhere: the series of one step is the method's
        own, and its power serves all pieces. None where following the steps one by one is no slower.
        """
        steps, n = len(self.loads[0]), self.loads[0].shape[-1]
        begin, later = (self._tangent(states, at, size) for at in (0, steps // 2))
        identity = np.eye(2 * n)[None]
        if _largest(np.stack((begin, later)) - begin[0]) <= ALIKE_WITHIN * _largest(begin):
            power = np.linalg.matrix_power(self._series(identity, begin[:1], 1)[0], steps)
            return np.broadcast_to(power, (self.count, 2 * n, 2 * n))
        few = self._steps_at_once(begin)
        if n**3 > MOST_PRODUCTS * few:
            return None
        out = np.broadcast_to(identity, (self.count, 2 * n, 2 * n))
        for first in range(0, steps, few):
            last = min(first + few, steps)
            out = self._series(out, self._tangent(states, (first + last) // 2, size), last - first)
        return out

    def _series(self, out: np.ndarray, tangent: np.ndarray, steps: int) -> np.ndarray:
        """What derivatives (count, 2 n, 2 n) are so many steps later, by the derivative of the accelerations."""
        n, term = tangent.shape[1], out
        for order in range(1, TAYLOR + 1):
            term = np.concatenate((term[:, n:], tangent @ term), axis=1) * (self.step * steps / order)
            out = out + term
        return out

    def _tangent(self, states: np.ndarray, at: int, size: np.ndarray) -> np.ndarray:
        """(count, n, 2 n), derivative of the accelerations by the state before a step, by differences."""
        z, load, by = states[at], self.loads[0][at], CHANGE * size
        n = load.shape[-1]
        out = np.empty((self.count, n, 2 * n))
        together = max(1, AT_ONCE // (2 * n * n))
        for first in range(0, self.count, together):
            part = slice(first, first + together)
            begin = self.slope(z[part], load[part])[..., n:]
            moved = self.slope(z[part] + np.diag(by)[:, None], load[part])[..., n:]
            out[part] = (moved - begin).transpose(1, 2, 0) / by
        return out

    def _steps_at_once(self, tangent: np.ndarray) -> int:
        """Steps in which the fastest motion goes no further than `ANGLE`; Gershgorin bounds its rate."""
        n = tangent.shape[1]
        stiffness, damping = (float(np.abs(x).sum(2).max()) for x in (tangent[:, :, :n], tangent[:, :, n:]))
        rate = max(math.sqrt(stiffness), damping)
        return max(1, min(len(self.loads[0]), int(ANGLE / (rate * self.step)))) if rate > 0 else len(self.loads[0])


def _move(gaps: np.ndarray, derivative: np.ndarray) -> np.ndarray:
    """Of the beginnings (count, 2 n), to where the gaps (count - 1, 2 n) would be closed, were the pieces linear."""
    out = np.zeros((len(gaps) + 1, gaps.shape[1]))
    for i, gap in enumerate(gaps):
        out[i + 1] = derivative[i] @ out[i] + gap
    return out


def _joined(record: _Pieces, states: np.ndarray, loads: tuple[np.ndarray, ...]) -> np.ndarray:
    """All states one after the other, and those of the steps behind the last piece."""
    steps, n = loads[0].shape
    length, count = len(states) - 1, record.count
    out = np.empty((steps + 1, 2 * n))
    out[: length * count] = states[:-1].swapaxes(0, 1).reshape(-1, 2 * n)
    z = out[length * count] = states[-1, -1]
    for i in range(length * count, steps):
        z = out[i + 1] = runge_kutta_step(record.slope, z, loads[0][i], loads[1][i], loads[2][i], record.step)
    return out
