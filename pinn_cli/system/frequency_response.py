"""What sensors show of what acts on masses that connections hold, at every frequency, and how it changes with both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np


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
        inverse: np.ndarray = np.linalg.inv(stiffness - self.omega[:, None, None] ** 2 * np.diag(self.mass))
        return inverse

    @cached_property
    def moved(self) -> np.ndarray:
        """(F, n, A), displacements for one of what acts."""
        pulled = self.stretch.T @ (self.connection[:, :, None] * self.acting.carried)
        moved: np.ndarray = self.flexibility @ (self.acting.pushed - self.mass[:, None] * self.acting.shaken - pulled)
        return moved

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
