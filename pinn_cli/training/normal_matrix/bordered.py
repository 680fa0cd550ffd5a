"""Symmetric positive definite systems of many readout weights, with few system parameters as a border."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.diagonals import Diagonals
from pinn_cli.training.normal_matrix.elimination import Elimination
from pinn_cli.training.normal_matrix.front_tree import FrontTree


@dataclass(frozen=True, eq=False)
class BorderedSystem:
    """Normal equations [[A, B], [B^T, C]] [w, x] = -[g, h], in float64 on the CPU, where LAPACK is.

    Attributes:
        band: A.
        border: B, (size, p).
        corner: C, (p, p).
        gradient: g, (size,).
        corner_gradient: h, (p,).
        tree: The order in which the readout weights are eliminated.
    """

    band: Diagonals
    border: csr_matrix
    corner: np.ndarray
    gradient: np.ndarray
    corner_gradient: np.ndarray
    tree: FrontTree

    def eliminated(self, damping: float = 0.0) -> Eliminated | None:
        """The readout weights eliminated, the diagonal times 1 + ``damping``; None if A is not positive definite."""
        readout = Elimination.of(self.tree, self.band, self.border, damping)
        if readout is None:
            return None
        schur = self.corner - readout.border_gram
        schur[np.diag_indices_from(schur)] += damping * np.diag(self.corner)
        return Eliminated(readout, schur)

    def readout_step(self) -> np.ndarray | None:
        """W (size,) of the solution with the parameters held; None if A is not positive definite."""
        readout = self._readout_alone()
        return None if readout is None else -readout.solved(readout.half_solved(self.gradient)[0], np.zeros(0))

    def readout_log_determinant(self) -> float:
        """Logarithm of the determinant of A; NaN if it is not positive definite."""
        readout = self._readout_alone()
        return math.nan if readout is None else readout.log_determinant

    def _readout_alone(self) -> Elimination | None:
        """A, factored without the border."""
        return Elimination.of(self.tree.alone, self.band, self.tree.alone.border)

    def decrease(self, step: tuple[np.ndarray, np.ndarray]) -> float:
        """What the system's own solution (w, x) takes off 2 [g, h] [w, x] + [w, x] H [w, x]."""
        return -float(self.gradient @ step[0] + self.corner_gradient @ step[1])


@dataclass(frozen=True, eq=False)
class Eliminated:
    """A :class:`BorderedSystem` without its readout weights.

    Attributes:
        readout: A, factored.
        complement: Schur complement C - B^T A^-1 B, (p, p), its corner damped.
    """

    readout: Elimination
    complement: np.ndarray

    def reduced(self, system: BorderedSystem) -> tuple[np.ndarray, np.ndarray]:
        """Half solved gradient (size,), and the parameters' right-hand side (p,), the readout weights eliminated."""
        half, right = self.readout.half_solved(system.gradient)
        return half, right - system.corner_gradient

    def readout_step(self, reduced: tuple[np.ndarray, np.ndarray], x: np.ndarray) -> np.ndarray:
        """W (size,) that goes with x (p,), from the reduced gradient."""
        return -self.readout.solved(reduced[0], x)


@dataclass(frozen=True, eq=False)
class ParameterFactor:
    """What is known of the parameters, readout weights marginalised.

    Attributes:
        schur: Cholesky factor of the Schur complement C - B^T A^-1 B, (p, p).
    """

    schur: np.ndarray

    @property
    def corner_covariance(self) -> np.ndarray:
        """(p, p), covariance of the parameters: the Schur complement's inverse."""
        inverse = solve_triangular(self.schur, np.eye(len(self.schur)), lower=True)
        return inverse.T @ inverse

    @property
    def parameter_log_determinant(self) -> float:
        """Logarithm of the determinant of the Schur complement."""
        return 2.0 * float(np.log(np.diag(self.schur)).sum())


@dataclass(frozen=True, eq=False)
class BorderedFactor(ParameterFactor):
    """A factored :class:`BorderedSystem`; other records may say something of its parameters as well.

    Attributes:
        readout: Of A.
    """

    readout: Elimination

    @property
    def size(self) -> int:
        """Of all unknowns."""
        return self.readout.size + len(self.schur)

    def draws(self, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readout weights (size, count) and parameters (p, count) with the inverse as covariance.

        Args:
            normals: (size + p, count), independent standard ones.
        """
        size = self.readout.size
        x = solve_triangular(self.schur, normals[size:], lower=True, trans="T")
        return self.readout.solved(normals[:size], -x), x

    def deviations(self, rows: np.ndarray, by_parameter: np.ndarray) -> np.ndarray:
        """(q,), standard deviations of linear functions of weights and parameters, with the inverse as covariance.

        Args:
            rows: (size, q), by the readout weights.
            by_parameter: (p, q).
        """
        own, taken = self.readout.half_solved(rows)
        through = solve_triangular(self.schur, by_parameter - taken, lower=True)
        deviation: np.ndarray = np.sqrt(np.sum(own**2, axis=0) + np.sum(through**2, axis=0))
        return deviation
