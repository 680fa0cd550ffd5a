"""The steps of a time integration: how long they may be, where a law divides them, and implicit ones.

Runge-Kutta takes steps that what is fastest in a structure asks for. No method of high order may step across the corner
of a law that is not smooth. Friction that sticks holds a mass like an enormous damper: Runge-Kutta stays stable with
hundreds of steps per sample only, LSODA (Petzold, SIAM J. Sci. Stat. Comput. 4, 1983, in scipy) takes some ten.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy.integrate import odeint

from pinn_cli.system.structure import Structure

# A load from times; the rate of a state under a load.
Force = Callable[[np.ndarray], np.ndarray]
Slope = Callable[[np.ndarray, np.ndarray], np.ndarray]

# Runge-Kutta is stable up to 2.8 and accurate to 1e-5 per radian at 0.2 (its phase error is (step * rate)^4 / 120).
STEP_TIMES_RATE = 0.2
# Of a mode that follows what acts on it, steps so much longer do: 1 rad with 0.2.
STABLE_STEP_OVER_STEP = 5.0
# Times the Nyquist frequency beyond which modes get mass, see :func:`with_slow_followers`: 25 steps per sample.
FASTEST_FOLLOWER = 8.0
# Steps of Runge-Kutta per sample from which on implicit steps are taken. Fifty put the highest mode at three times the
# Nyquist frequency of the record.
MOST_SUBSTEPS = 50


class TooStiffError(ValueError):
    """A structure that a record's sampling is much too slow for; the message says by how much."""


def method_needed(structure: Structure, step: float) -> tuple[str, int]:
    """How a structure is followed between samples: ``rk4`` with so many steps, or ``lsoda``."""
    substeps = substeps_needed(structure, step)
    return "lsoda" if substeps > MOST_SUBSTEPS or has_stiff_law(structure) else "rk4", substeps


def has_stiff_law(structure: Structure) -> bool:
    """Whether only implicit steps follow it, see :attr:`Nonlinearity.is_stiff`."""
    return any(group.nonlinearity.is_stiff for group in structure.groups)


def substeps_needed(structure: Structure, step: float, step_times_rate: float = STEP_TIMES_RATE) -> int:
    """Steps of Runge-Kutta per sample that resolve the linear part's highest natural frequency and strongest damping.

    Of modes, those above the Nyquist frequency follow what acts on them at once: they need no more than to stay stable.
    No number of steps is enough where a mass is zero.
    """
    angle = step * rates(structure).max(axis=0)
    beyond = (angle > math.pi) & structure.is_modal
    steps = angle / np.where(beyond, STABLE_STEP_OVER_STEP * step_times_rate, step_times_rate)
    return max(1, math.ceil(steps.max()))


def follower_masses(structure: Structure, step: float) -> np.ndarray:
    """(n,), factors of at least 1 on the masses, with which no mode is faster than so many times the Nyquist frequency.

    Modes far beyond a record's band follow what acts on them at once, and would make steps short for nothing. With
    mass added they do the same under anything slow: at a frequency f they are off by (f / fastest)^2.
    """
    if not structure.is_modal:
        return np.ones(structure.coordinates)
    fastest = FASTEST_FOLLOWER * math.pi / step
    oscillation, decay = rates(structure) / fastest
    return np.maximum(1.0, np.maximum(oscillation**2, decay))


def with_slow_followers(structure: Structure, step: float) -> Structure:
    """The same structure with these masses; the ground pushes it as before."""
    masses = follower_masses(structure, step)
    if (masses == 1.0).all():
        return structure
    slower = structure.with_parameters(m=structure.parameters["m"] * torch.as_tensor(masses))
    return replace(slower, influence=structure.with_ground / masses)


def rates(structure: Structure) -> np.ndarray:
    """(2, n), rad/s and 1/s: natural frequencies and damping at rest are at most the largest of all coordinates'.

    Gershgorin bounds the eigenvalues of M^-1 K (and of M^-1 C alike) by the sums over the connections at a mass, of a
    chain by 2 (|k_i| + |k_i+1|) / |m_i|; an estimated one may have negative ones.
    """
    pull = abs(structure.incidence.matrix)
    # A mode's own spring is stretched by that mode alone, and its rate is no bound.
    weight = np.maximum(0.0 if structure.is_modal else 2.0, np.asarray(pull.sum(axis=1)).reshape(-1))
    mass = np.abs(structure.parameters_like(np.empty(0))["m"])
    stiffness, damping = (pull.T @ (weight * value) / mass for value in at_rest(structure))
    return np.array((np.sqrt(stiffness), damping))


def at_rest(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Size of stiffness (N/m) and of damping (N s/m) of every connection (C,), those of its law at rest included."""
    k, c = (np.abs(parts).sum(axis=0) for parts in structure.at_rest())
    return k, c


# Half-width of the part of a step about a corner that is taken by itself, over the step: what a step across a corner is
# in error by falls with its square.
MARGIN = 1.0 / 128.0
# A law that turns over a speed is straight beyond so many times it, and takes steps of such a part of it.
STRAIGHT, FINE = 6.0, 0.3
# Loads at both ends of a step without supports that move.
AT_REST = (np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class Corners:
    """Of the states of a structure: connections whose elongation turns round, and hidden forces that change sign.

    Attributes:
        rate: (corners, states), the elongations' rates from states in a row.
        width: (corners,), the speeds that the laws turn over, m/s; 0: at once.
        hidden: The hidden forces among the states.
        by_supports: (corners, S), the rates from the velocities of supports that move.
    """

    rate: np.ndarray
    width: np.ndarray
    hidden: slice
    by_supports: np.ndarray

    @classmethod
    def of(cls, structure: Structure) -> Corners | None:
        """Those of a structure; None where all its laws are smooth."""
        p = structure.parameters_like(np.empty(0))
        places, widths = [], []
        for group, part in zip(structure.groups, structure.parts, strict=True):
            width = group.nonlinearity.reversal_speed
            if width is not None:
                connections = np.arange(structure.incidence.shape[0])[part.connections]
                places.append(connections)
                widths.append(np.full(len(connections), width))
        if not places:
            return None
        n, hidden = len(p["m"]), len(structure.memory)
        rate = np.zeros((sum(map(len, places)), 2 * n + hidden))
        stretch = structure.stretch.matrix[np.concatenate(places)].toarray()
        rate[:, n : 2 * n] = stretch[:, :n]
        return cls(rate, np.concatenate(widths), slice(2 * n, 2 * n + hidden), stretch[:, n:])

    @property
    def shortest(self) -> float:
        """Least length of the parts that a step is divided into, over the step."""
        return MARGIN / 32.0 if self.width.any() else MARGIN

    def cuts(
        self, before: np.ndarray, after: np.ndarray, least: float, loads: Sequence[np.ndarray] = AT_REST
    ) -> np.ndarray:
        """Where a step is divided, in ascending order, over the step, by the states before and after one taken at once.

        Cuts are a distance ``least``, at most a half, from either end: without one, a step that begins at a corner
        would be divided there again and again. Loads at both ends hold the velocity of supports that move.
        """
        moved = self.by_supports.shape[1]
        carried = [self.by_supports @ load[1, -moved:] if moved else 0.0 for load in loads]
        first, last = (
            np.concatenate((self.rate @ state + by_supports, state[self.hidden]))
            for state, by_supports in zip((before, after), carried, strict=True)
        )
        sharp, wide = self._sharp & (first * last < 0.0), self._across(first, last)
        if not sharp.any() and not wide.any():
            return np.zeros(0)
        there = first[sharp] / (first[sharp] - last[sharp])
        cuts = [there - MARGIN, there + MARGIN]
        for x, y, width in zip(first[wide], last[wide], self._widths[wide], strict=True):
            ends = np.clip([x, y], -STRAIGHT * width, STRAIGHT * width)
            count = int(np.ceil(abs(ends[1] - ends[0]) / (FINE * width)))
            cuts.append((np.linspace(ends[0], ends[1], count + 1) - x) / (y - x))
        return np.unique(np.clip(np.concatenate(cuts), least, 1.0 - least))

    @cached_property
    def _widths(self) -> np.ndarray:
        return np.concatenate((self.width, np.zeros(self.hidden.stop - self.hidden.start)))

    @cached_property
    def _sharp(self) -> np.ndarray:
        return self._widths == 0.0

    def _across(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Whether a step is too long for a law that turns over a speed."""
        low, high, straight = np.minimum(first, last), np.maximum(first, last), STRAIGHT * self._widths
        return ~self._sharp & (high - low > FINE * self._widths) & (low < straight) & (high > -straight)


# Error of a step, over the state and over what the loads make of it within a sample.
TOLERATED_ERROR = 1e-7
# Of a contact that sticks, the speed over which its force turns round, over the velocity that loads make within a
# sample: twenty times the error of a step. In a narrower one the error alone turns the force, and steps never end.
TURNS_OVER = 20.0 * TOLERATED_ERROR
# Slopes that are taken per sample of what is behind, with so many samples in advance. Sticking friction takes 10 to 30.
MOST_SLOPES, IN_ADVANCE = 400, 50
# Implicit steps of LSODA between two samples: no bound, `MOST_SLOPES` is one.
ANY_NUMBER = 10**6
# A load goes on by polynomials of this degree, so many in a sample: exact for the splines through samples, and to
# 1e-10 of a sine at nine tenths of the Nyquist frequency. Samples whose polynomials are worked out at once.
LOAD_DEGREE, LOAD_PIECES, LOAD_BLOCK = 7, 4, 512


class PiecewiseLoad:
    """A load for an integrator, which asks for one time after the other: a seventh of a spline's own time for that.

    Args:
        force: Load (M, ...) at any times (M,), s, a few samples beyond the last one too.
        time: (N,), s, even.
    """

    def __init__(self, force: Force, time: np.ndarray) -> None:
        self.force, self.first, self.piece = force, float(time[0]), float(time[1] - time[0]) / LOAD_PIECES
        self._block, self._coefficients, self._shape = -1, np.empty(0), (0,)
        self._powers = np.arange(LOAD_DEGREE + 1)
        self._points = np.polynomial.chebyshev.chebpts1(LOAD_DEGREE + 1)
        self._solved = np.linalg.inv(np.vander(self._points, increasing=True))

    def __call__(self, at: float) -> np.ndarray:
        """The load at a time, s."""
        place = (at - self.first) / self.piece
        block, piece = divmod(int(place), LOAD_BLOCK * LOAD_PIECES)
        if block != self._block:
            self._block, self._coefficients = block, self._of(block)
        of_piece = 2.0 * (place - int(place)) - 1.0
        return (of_piece**self._powers).dot(self._coefficients[piece]).reshape(self._shape)

    def _of(self, block: int) -> np.ndarray:
        """(pieces, powers, values), of a block."""
        pieces = np.arange(block * LOAD_BLOCK * LOAD_PIECES, (block + 1) * LOAD_BLOCK * LOAD_PIECES)
        at = self.first + self.piece * (pieces[:, None] + 0.5 + 0.5 * self._points)
        values = self.force(at.ravel())
        self._shape = values.shape[1:]
        return np.asarray(self._solved @ values.reshape(*at.shape, -1))


def implicit_steps(
    slope: Slope, force: Force, time: np.ndarray, sampled: np.ndarray, hold: str, start: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """The states at all samples (N, ...) of even times (N,), s; not finite from where on the state is not.

    The load of a state's slope is ``force`` at any times, and ``sampled`` (N, ...) at those of the samples, which it
    keeps where the hold is ``zero_order``. The start holds displacements, velocities and hidden forces; ``size`` is
    that of :func:`made_in_a_sample`.

    Raises:
        TooStiffError: It takes more than `MOST_SLOPES` slopes per sample.
    """
    step, shape, taken, load = float(time[1] - time[0]), start.shape, 0, PiecewiseLoad(force, time)
    states = np.full((len(time), start.size), np.nan)
    states[0] = start.ravel()

    def rate(y: np.ndarray, t: float, held: np.ndarray | None) -> np.ndarray:
        nonlocal taken
        taken += 1
        if taken > MOST_SLOPES * ((t - time[0]) / step + IN_ADVANCE):
            raise TooStiffError(f"it takes more than {MOST_SLOPES} evaluations per sample, by implicit steps too")
        return slope(y.reshape(shape), load(t) if held is None else held).ravel()

    options = {"rtol": TOLERATED_ERROR, "atol": TOLERATED_ERROR * size}
    parts = [(0, len(time), None)] if hold == "exact" else [(k, k + 2, sampled[k]) for k in range(len(time) - 1)]
    for begin, end, held in parts:
        at = time[begin:end]
        solution, info = odeint(
            rate, states[begin], at, (held,), full_output=True, hmax=step, mxstep=ANY_NUMBER, **options
        )  # fmt: skip
        reached = len(at) if info["message"] == "Integration successful." else 1
        states[begin + 1 : begin + reached] = solution[1:reached]
        if reached == 1:
            break
    return states.reshape(-1, *shape)


def made_in_a_sample(slope: Slope, sampled: np.ndarray, start: np.ndarray, step: float, coordinates: int) -> np.ndarray:
    """(states,), what loads (N, ...) make of displacements, velocities and hidden forces within a sample, at most.

    They make velocities at their rates from the start, and all else at the rates that follow from these.
    """
    first = start + step * np.array([slope(start, load) for load in sampled])
    moved = start + step * np.array([slope(state, load) for state, load in zip(first, sampled, strict=True)])
    most, out = np.abs(np.concatenate((first, moved))).reshape(-1, start.size).max(axis=0), np.empty(start.size)
    for part in (slice(coordinates), slice(coordinates, 2 * coordinates), slice(2 * coordinates, None)):
        out[part] = max(most[part].max(initial=0.0), np.finfo(float).tiny)
    return out
