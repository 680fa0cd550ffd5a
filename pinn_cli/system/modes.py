"""Modes of a linear structure: its poles, and how its coordinates move in each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pinn_cli.system.structure import Structure

# Of the highest natural frequency's square: below it is a rigid body's motion, but for rounding.
RIGID = 1e-12


@dataclass(frozen=True, eq=False)
class Modes:
    """Complex modes of M u'' + C u' + K u = f.

    Attributes:
        m: (n,), kg.
        K, C: (n, n), N/m and N s/m.
        poles: (2n,), 1/s.
        vectors: (n, 2n), displacements of the coordinates in each mode.
        inputs: (2n, n), what a unit acceleration f/m on a coordinate puts into each mode.
        structure: Whose modes they are.
    """

    m: np.ndarray
    K: np.ndarray
    C: np.ndarray
    poles: np.ndarray
    vectors: np.ndarray
    inputs: np.ndarray
    structure: Structure

    @classmethod
    def of(cls, structure: Structure) -> Modes:
        """Of a structure at rest: hidden forces that follow the elongations are springs, nonlinear dampers do nothing.

        At rest a friction joint sticks, and a Van der Pol damper feeds energy in: neither is what they do in motion.
        """
        stretch = structure.incidence.matrix.toarray()
        m, n = structure.parameters_like(np.empty(0))["m"], structure.coordinates
        stiffness, damping = structure.at_rest()
        K, C = (stretch.T @ (values[:, None] * stretch) for values in (stiffness.sum(axis=0), damping[0]))
        state = np.block([[np.zeros((n, n)), np.eye(n)], [-K / m[:, None], -C / m[:, None]]])
        poles, vectors = np.linalg.eig(state)
        return cls(m, K, C, poles, vectors[:n], np.linalg.inv(vectors)[:, n:], structure)

    @property
    def shapes(self) -> np.ndarray:
        """(dofs, 2n), displacements of the DOFs in each mode."""
        return self.structure.shapes.matrix @ self.vectors

    @property
    def pushed(self) -> np.ndarray:
        """(2n, dofs), what a unit force on a DOF puts into each mode."""
        return (self.inputs / self.m) @ self.structure.shapes.matrix.T

    @property
    def stable(self) -> bool:
        """Whether every free motion dies away; rounding is not held against it."""
        return bool(np.all(self.poles.real <= 1e-9 * np.abs(self.poles)))

    @property
    def natural_frequencies(self) -> np.ndarray:
        """(n,) undamped, Hz, ascending; 0 of a rigid body's motion, NaN where the stiffness is negative."""
        root = np.sqrt(self.m)
        squares = np.linalg.eigvalsh(self.K / np.outer(root, root))
        squares[np.abs(squares) <= RIGID * np.abs(squares).max()] = 0.0
        return np.sqrt(np.where(squares >= 0, squares, np.nan)) / (2 * np.pi)


def modes_of(structure: Structure) -> Modes:
    """Of the linear part of a structure."""
    return Modes.of(structure)
