"""Displacements that forces make of masses on connections, at every frequency, and how they change with both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Flexibility:
    """(B' D B - omega^2 M)^-1: D holds the connections' dynamic stiffnesses, k + i omega c, and B stretches them.

    Attributes:
        omega: (F,), rad/s.
        stretch: (C, n), B.
        mass: (n,), diagonal of M, kg.
        connection: (F, C), diagonal of D, N/m.
    """

    omega: np.ndarray
    stretch: np.ndarray
    mass: np.ndarray
    connection: np.ndarray

    @cached_property
    def matrix(self) -> np.ndarray:
        """(F, n, n), m/N."""
        stiffness = (self.stretch.T * self.connection[:, None]) @ self.stretch
        stiffness[:, range(len(self.mass)), range(len(self.mass))] -= self.omega[:, None] ** 2 * self.mass
        inverse: np.ndarray = np.linalg.inv(stiffness)
        return inverse


@dataclass(frozen=True, eq=False)
class Slopes:
    """What sensors show (F, S, A) of what acts, as it changes with masses and connections.

    Attributes:
        seen: (F, S, n), what sensors show of forces on the coordinates.
        pulled: (F, S, C), of forces in the connections.
        inertia: (F, n, A), what acts makes of every coordinate's acceleration, the ground's included, times -1.
        stretched: (F, C, A), of every connection's elongation, that by supports included.
    """

    seen: np.ndarray
    pulled: np.ndarray
    inertia: np.ndarray
    stretched: np.ndarray

    def by(self, mass: np.ndarray, connection: np.ndarray) -> np.ndarray:
        """(F, S, A), by a number that adds this to masses (n,) and to the connections' dynamic stiffness (F, C)."""
        m, c = np.flatnonzero(mass), np.flatnonzero(connection.any(axis=0))
        of_masses = (self.seen[:, :, m] * mass[m]) @ self.inertia[:, m]
        slope: np.ndarray = of_masses - (self.pulled[:, :, c] * connection[:, None, c]) @ self.stretched[:, c]
        return slope
