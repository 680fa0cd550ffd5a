"""Other masses and stiffnesses with which a structure does the same at its sensors under the same inputs.

A record of a few sensors may fit several structures exactly: of the roof of a frame whose base shakes, it shows the
frequencies, and as many sets of storeys as there are solutions of their equations have these (Udwadia and Sharma, SIAM
Journal on Applied Mathematics 34, 1978). Damping is left out: what two undamped structures have in common off the axis
of real frequencies, where no response has a peak, they have everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pinn_cli.system.natural_modes import at_rest
from pinn_cli.system.parameters import MASS, Parameter
from pinn_cli.system.structure import Structure

STIFFNESS = "k"
# Complex frequencies that are compared for every mode, and how far off the axis they lie, as a part of their distance
# from the origin: widely first, so that the way downhill leads from one set of modes to another.
PER_MODE, OFF_AXIS = 3, (0.5, 0.1)
# Starts: every free parameter so many times as large and as small, where they are few, and all of them scattered by so
# much as logarithms, more often where they are few.
FACTOR, SCATTER = 2.5, 0.7
FEW, OFTEN, RARELY = 12, 16, 6
FARTHEST, EVALUATIONS = np.log(30.0), 40
# Relative rms difference of two responses that are the same as far as a record can tell, and the relative difference
# of a parameter that makes two structures different.
SAME_RESPONSE, SAME = 0.01, 0.05
# Of the largest response, below which none is compared more closely.
LEAST = 1e-3


@dataclass(frozen=True, eq=False)
class Seen:
    """What a record sees of a structure.

    Attributes:
        sensing: (S, n), the displacements that every sensor feels, whatever derivative of them.
        acting: (n, F), the forces that every input exerts; of the ground's motion those for masses of one.
        by_mass: (F,) bool, the inputs that pull at every mass in proportion to it: the ground's.
        low, high: Between which it shows anything, Hz.
        stretching: (C, F), how far every input stretches each connection by itself: the displacement of a support;
            None: no support moves.
    """

    sensing: np.ndarray
    acting: np.ndarray
    by_mass: np.ndarray
    low: float
    high: float
    stretching: np.ndarray | None = None


def twins(structure: Structure, free: Sequence[Parameter], seen: Seen, most: int) -> list[dict[Parameter, float]]:
    """The masses and stiffnesses of other structures that nobody who sees no more can tell from this one.

    Args:
        structure: In DOFs; its connections as they are at rest.
        free: Parameters that may be others; all but masses and stiffnesses are left out.
        seen: Of it.
        most: How many at most; those that come nearest.
    """
    free = [p for p in free if p.kind in (MASS, STIFFNESS) and _positive(structure, p)]
    if not free or not seen.sensing.size or not seen.acting.size or not seen.low < seen.high:
        return []
    match = _Match(structure, free, seen)
    ends = match.starts()
    for off_axis in OFF_AXIS:
        match.look(off_axis)
        ends = [match.fitted(x) for x in ends]
    found: list[tuple[float, np.ndarray]] = []
    for x in ends:
        apart = match.apart(x)
        known = [np.zeros(len(free)), *(other for _, other in found)]
        if apart < SAME_RESPONSE and all(np.abs(x - other).max() > SAME for other in known):
            found.append((apart, x))
    found.sort(key=lambda pair: pair[0])
    return [dict(zip(free, match.values * np.exp(x), strict=True)) for _, x in found[:most]]


def _positive(structure: Structure, parameter: Parameter) -> bool:
    value = float(structure.parameters[parameter.kind][parameter.index])
    return np.isfinite(value) and value > 0


class _Match:
    """The difference of two responses, by the logarithms of the free parameters over their values.

    Args:
        structure, free, seen: See :func:`twins`.
    """

    def __init__(self, structure: Structure, free: Sequence[Parameter], seen: Seen) -> None:
        parameters = structure.parameters_like(np.empty(0))
        self.seen, self.stretch = seen, structure.incidence.matrix.toarray()
        own = np.zeros((len(self.stretch), seen.acting.shape[1]))
        self.carried = own if seen.stretching is None else seen.stretching
        self.mass, self.stiffness = parameters[MASS].copy(), at_rest(structure)[0]
        self.masses = np.array([p.kind == MASS for p in free])
        self.index = np.array([p.index for p in free])
        self.values = np.array([float(parameters[p.kind][p.index]) for p in free])
        self.look(OFF_AXIS[0])

    def look(self, off_axis: float) -> None:
        """Choose how far off the axis of real frequencies the responses are compared."""
        count = max(PER_MODE * len(self.mass), 2 * len(self.values) + 2)
        omega = 2.0 * np.pi * np.geomspace(self.seen.low, self.seen.high, count)
        self.s = omega * (1j + off_axis)
        self.wanted = self._response(np.zeros(len(self.values)))[0]
        size = np.abs(self.wanted)
        # Next to a zero of a response a difference may be large relative to it, and still nobody sees it.
        # Through springs of no stiffness nothing is felt at all.
        self.size = np.maximum(np.maximum(size, LEAST * size.max(axis=0)), np.finfo(float).tiny) * np.sqrt(size.size)

    def starts(self) -> list[np.ndarray]:
        """Logarithms of factors, the same ones every time."""
        p = len(self.values)
        few = p <= FEW
        single = [sign * np.log(FACTOR) * np.eye(p)[i] for i in range(p) for sign in (1.0, -1.0)] if few else []
        scattered = SCATTER * np.random.default_rng(0).standard_normal((OFTEN if few else RARELY, p))
        return [*single, *scattered]

    def fitted(self, x: np.ndarray) -> np.ndarray:
        """The bottom of the valley that x lies in; x where it has none that numbers can tell."""
        x = np.clip(x, -0.99 * FARTHEST, 0.99 * FARTHEST)
        if not np.isfinite(self.apart(x)):
            return x
        best = least_squares(
            lambda x: _real(self._response(x)[0] - self.wanted, self.size),
            x,
            lambda x: _real(self._response(x)[1], self.size[..., None]),
            (-FARTHEST, FARTHEST),
            max_nfev=EVALUATIONS,
        )
        solution: np.ndarray = best.x
        return solution

    def apart(self, x: np.ndarray) -> float:
        """Relative rms difference of the responses."""
        return float(np.sqrt(np.sum(np.abs((self._response(x)[0] - self.wanted) / self.size) ** 2)))

    def _response(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements at the sensors for one of every input, (B, S, F), and their slopes, (B, S, F, p)."""
        mass, stiffness = self.mass.copy(), self.stiffness.copy()
        values = self.values * np.exp(x)
        mass[self.index[self.masses]] = values[self.masses]
        springs = ~self.masses
        stiffness[self.index[springs]] += values[springs] - self.values[springs]
        stretch = self.stretch / np.sqrt(mass)
        squares, shapes = np.linalg.eigh(stretch.T @ (stiffness[:, None] * stretch))
        shapes = shapes / np.sqrt(mass)[:, None]
        acting = np.where(self.seen.by_mass, mass[:, None] * self.seen.acting, self.seen.acting)
        acting = acting - self.stretch.T @ (stiffness[:, None] * self.carried)
        gain = 1.0 / (self.s[:, None] ** 2 + squares)  # (B, modes)
        sensed, driven = self.seen.sensing @ shapes, shapes.T @ acting
        response = np.einsum("sr,br,rf->bsf", sensed, gain, driven)
        # What every free parameter feels: its mass's acceleration, its connection's elongation.
        felt = np.where(self.masses[:, None], shapes[np.where(self.masses, self.index, 0)], 0.0)
        felt[springs] = (self.stretch @ shapes)[self.index[springs]]
        left, right = np.einsum("sr,br,pr->bsp", sensed, gain, felt), np.einsum("pr,br,rf->bpf", felt, gain, driven)
        right[:, springs] += self.carried[self.index[springs]]
        rate = np.where(self.masses, self.s[:, None] ** 2, 1.0) * values  # (B, p)
        slopes = -np.einsum("bsp,bpf,bp->bsfp", left, right, rate)
        for column in np.flatnonzero(self.masses):  # a heavier mass also feels more of the ground
            more = np.where(self.seen.by_mass, values[column] * self.seen.acting[self.index[column]], 0.0)
            slopes[..., column] += left[:, :, column, None] * more
        return response, slopes


def _real(values: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(..., p) or (...) complex as real rows."""
    scaled = values / size
    rows = scaled.reshape(-1, values.shape[-1]) if values.ndim == 4 else scaled.reshape(-1)
    return np.concatenate((rows.real, rows.imag))
