"""What sensors show at every frequency of what acts on a structure; and other structures of which they show the same.

A record of a few sensors may fit several structures exactly: of the roof of a frame whose base shakes, it shows the
frequencies, and as many sets of storeys as there are solutions of their equations have these (Udwadia and Sharma, SIAM
Journal on Applied Mathematics 34, 1978). Damping is left out: what two undamped structures have in common off the axis
of real frequencies, where no response has a peak, they have everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from pinn_cli.system.modes import at_rest
from pinn_cli.system.parameters import MASS, Parameter
from pinn_cli.system.structure import Structure

STIFFNESS = "k"
# Complex frequencies that are compared for every mode, and how far off the axis they lie, as a part of their distance
# from the origin: widely first, so that the way downhill leads from one set of modes to another.
PER_MODE, OFF_AXIS = 3, (0.5, 0.1)
# Starts: every free parameter so many times as large and as small, where they are few, and all of them scattered by so
# much as logarithms, more often where they are few.
START_FACTOR, SCATTER = 2.5, 0.7
FEW, OFTEN, RARELY = 12, 16, 6
FARTHEST_START, EVALUATIONS = np.log(30.0), 40
# Relative rms difference of two responses that are the same as far as a record can tell, and the relative difference
# of a parameter that makes two structures different.
SAME_RESPONSE, SAME = 0.01, 0.05
# Of the largest response, below which none is compared more closely.
LEAST = 1e-3


@dataclass(frozen=True, eq=False)
class Acting:
    """A inputs: forces, motions of supports, the ground's acceleration.

    Attributes:
        pushed: (n, A), the coordinates that forces push.
        shaken: (n, A), how far coordinates move with the ground.
        carried: (F, C, A), elongations of connections that the motions of supports make.
    """

    pushed: np.ndarray
    shaken: np.ndarray
    carried: np.ndarray

    @classmethod
    def forces(cls, pushed: np.ndarray) -> Acting:
        """Forces alone."""
        return cls(pushed, np.zeros_like(pushed), np.zeros((1, 1, 1)))

    @classmethod
    def of(cls, inputs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], coordinates: int) -> Acting:
        """Of inputs one by one: what they push (n,), how they shake it (n,), what they carry (C,)."""
        if not inputs:
            return cls.forces(np.zeros((coordinates, 0)))
        pushed, shaken, carried = (np.stack(part, axis=1) for part in zip(*inputs, strict=True))
        return cls(pushed, shaken, carried[None])


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """H (B' D B - omega^2 M)^-1 (P - M I - B' D G): connections have the dynamic stiffnesses D = k + i omega c.

    Attributes:
        omega: (F,), rad/s.
        stretch: (C, n), B.
        sensing: (F, S, n), H, from displacements to what sensors show.
        acting: P, I and G.
        mass: (n,), diagonal of M, kg.
        connection: (F, C), diagonal of D, N/m.
    """

    omega: np.ndarray
    stretch: np.ndarray
    sensing: np.ndarray
    acting: Acting
    mass: np.ndarray
    connection: np.ndarray

    @cached_property
    def flexibility(self) -> np.ndarray:
        """(F, n, n), m/N."""
        stiffness = (self.stretch.T * self.connection[:, None]) @ self.stretch
        return np.linalg.inv(stiffness - self.omega[:, None, None] ** 2 * np.diag(self.mass))

    @cached_property
    def moved(self) -> np.ndarray:
        """(F, n, A), displacements for one of what acts."""
        pulled = self.stretch.T @ (self.connection[:, :, None] * self.acting.carried)
        return self.flexibility @ (self.acting.pushed - self.mass[:, None] * self.acting.shaken - pulled)

    @property
    def value(self) -> np.ndarray:
        """(F, S, A)."""
        return self.sensing @ self.moved

    @cached_property
    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What sensors show of forces on coordinates and in connections; accelerations, times -1, and elongations."""
        seen = self.sensing @ self.flexibility
        accelerated = self.omega[:, None, None] ** 2 * self.moved - self.acting.shaken
        return seen, seen @ self.stretch.T, accelerated, self.stretch @ self.moved + self.acting.carried

    def slope(self, mass: np.ndarray, connection: np.ndarray) -> np.ndarray:
        """(F, S, A), by a number that adds this to masses (n,) and to dynamic stiffnesses (F, C)."""
        seen, pulled, accelerated, stretched = self._parts
        m, c = np.flatnonzero(mass), np.flatnonzero(connection.any(axis=0))
        slope: np.ndarray = (seen[:, :, m] * mass[m]) @ accelerated[:, m]
        return slope - (pulled[:, :, c] * connection[:, None, c]) @ stretched[:, c]


def real_rows(values: np.ndarray) -> np.ndarray:
    """Real and imaginary parts, one below the other."""
    return np.concatenate((values.real, values.imag))


@dataclass(frozen=True, eq=False)
class Seen:
    """What a record sees of a structure.

    Attributes:
        sensing: (S, n), the displacements that every sensor feels, whatever derivative of them.
        acting: F inputs.
        low, high: Between which it shows anything, Hz.
        released: (2, n), displacement and velocity with which it begins, where nothing acts; nobody knows them.
    """

    sensing: np.ndarray
    acting: Acting
    low: float
    high: float
    released: np.ndarray | None = None


def rivals_of(structure: Structure, free: Sequence[Parameter], seen: Seen, most: int) -> list[dict[Parameter, float]]:
    """The masses and stiffnesses of other structures that nobody who sees no more can tell from this one.

    Of ``free``, which may be others, all but masses and stiffnesses are left out. The structure is in DOFs, its
    connections are as they are at rest. Of more than ``most`` those are told that come nearest.
    """
    free = [
        p for p in free if p.kind in (MASS, STIFFNESS) and 0.0 < float(structure.parameters[p.kind][p.index]) < np.inf
    ]
    acts = seen.released is not None or seen.acting.pushed.size
    if not free or not seen.sensing.size or not acts or not seen.low < seen.high:
        return []
    match = _Match(structure, free, seen)
    ends = match.starts()
    for off_axis in OFF_AXIS:
        match.look(off_axis)
        ends = [match.fitted(x) for x in ends]
    rivals: list[tuple[float, np.ndarray]] = []
    for x in ends:
        difference = match.difference(x)
        others = [np.zeros(len(free)), *(other for _, other in rivals)]
        if difference < SAME_RESPONSE and all(np.abs(x - other).max() > SAME for other in others):
            rivals.append((difference, x))
    rivals.sort(key=lambda pair: pair[0])
    return [dict(zip(free, match.values * np.exp(x), strict=True)) for _, x in rivals[:most]]


class _Match:
    """The difference of two responses, by the logarithms of the free parameters over their values."""

    def __init__(self, structure: Structure, free: Sequence[Parameter], seen: Seen) -> None:
        parameters = structure.parameters_like(np.empty(0))
        self.seen, self.stretch = seen, structure.incidence.matrix.toarray()
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
        response = self._response(np.zeros(len(self.values)))
        self.wanted = response.value
        if self.seen.released is not None:
            displacement, velocity = self.seen.released
            pushed = self.mass * (self.s[:, None] * displacement + velocity)
            self.wanted = response.sensing @ response.flexibility @ pushed[..., None]
        size = np.abs(self.wanted)
        # Next to a zero of a response a difference may be large relative to it, and still nobody sees it.
        # Through springs of no stiffness nothing is felt at all.
        self.size = np.maximum(np.maximum(size, LEAST * size.max(axis=0)), np.finfo(float).tiny) * np.sqrt(size.size)

    def starts(self) -> list[np.ndarray]:
        """Logarithms of factors, the same ones every time."""
        p = len(self.values)
        few = p <= FEW
        single = [sign * np.log(START_FACTOR) * np.eye(p)[i] for i in range(p) for sign in (1.0, -1.0)] if few else []
        scattered = SCATTER * np.random.default_rng(0).standard_normal((OFTEN if few else RARELY, p))
        return [*single, *scattered]

    def fitted(self, x: np.ndarray) -> np.ndarray:
        """The bottom of the valley that x lies in; x where it has none that numbers can tell."""
        x = np.clip(x, -0.99 * FARTHEST_START, 0.99 * FARTHEST_START)
        if not np.isfinite(self.difference(x)):
            return x
        bounds = (-FARTHEST_START, FARTHEST_START)
        slopes = self.slopes if self.seen.released is None else "2-point"
        return least_squares(self._differences, x, slopes, bounds, max_nfev=EVALUATIONS).x

    def difference(self, x: np.ndarray) -> float:
        """Relative rms difference of the responses."""
        return float(np.sqrt(np.sum(self._differences(x) ** 2)))

    def _differences(self, x: np.ndarray) -> np.ndarray:
        """Over their sizes, as real rows; of a structure that was let go with whatever motion comes nearest."""
        response = self._response(x)
        if self.seen.released is None:
            return real_rows(((response.value - self.wanted) / self.size).reshape(-1))
        felt = response.sensing @ response.flexibility / self.size
        columns = np.concatenate((felt, self.s[:, None, None] * felt), axis=2)
        rows, wanted = (real_rows(x.reshape(self.size.size, -1)) for x in (columns, self.wanted / self.size))
        rows /= np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        difference: np.ndarray = rows @ np.linalg.lstsq(rows, wanted, rcond=None)[0] - wanted
        return difference[:, 0]

    def _response(self, x: np.ndarray) -> FrequencyResponse:
        """Displacements at the sensors for one of every input."""
        mass, stiffness = self.mass.copy(), self.stiffness.copy()
        values, springs = self.values * np.exp(x), ~self.masses
        mass[self.index[self.masses]] = values[self.masses]
        stiffness[self.index[springs]] += values[springs] - self.values[springs]
        stiffness = np.tile(stiffness, (len(self.s), 1))
        return FrequencyResponse(-1j * self.s, self.stretch, self.seen.sensing[None], self.seen.acting, mass, stiffness)

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Of :meth:`_differences`, where what acts is known."""
        response, values = self._response(x), self.values * np.exp(x)
        masses, connections = np.arange(len(self.mass)), np.arange(len(self.stiffness))
        by = [
            response.slope(value * (is_mass & (masses == i)), value * np.atleast_2d(~is_mass & (connections == i)))
            for value, is_mass, i in zip(values, self.masses, self.index, strict=True)
        ]
        return real_rows((np.stack(by, axis=-1) / self.size[..., None]).reshape(-1, len(x)))
