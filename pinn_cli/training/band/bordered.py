"""Symmetric positive definite systems of many readout weights, with few system parameters as a border."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls
from scipy.sparse import csr_matrix

from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.elimination import Elimination
from pinn_cli.training.band.front_tree import FrontTree

# Steps that a bounded solution may take per parameter; one or two is the rule.
NNLS_STEPS = 100


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
        known: (p, p), covariance of parameters that something else has told: a step leaves them where they are, and
            the readout weights' covariance is that about the parameters and what these add. None: they are solved for.
    """

    band: Diagonals
    border: csr_matrix
    corner: np.ndarray
    gradient: np.ndarray
    corner_gradient: np.ndarray
    tree: FrontTree
    known: np.ndarray | None = None

    def factor(self, damping: float = 0.0) -> BorderedFactor | None:
        """Cholesky factors with the diagonal scaled to one plus ``damping``; None if not positive definite."""
        eliminated = self.eliminated(damping)
        if eliminated is None:
            return None
        return eliminated.factor(eliminated.complement if self.known is None else np.linalg.inv(self.known))

    def eliminated(self, damping: float = 0.0) -> Eliminated | None:
        """The readout weights eliminated, damped likewise; None if A is not positive definite."""
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

    def factor(self, complement: np.ndarray) -> BorderedFactor | None:
        """With the complement's Cholesky factor; None if it is not positive definite.

        Args:
            complement: (p, p), its own, or that of several systems which share their parameters.
        """
        try:
            schur = np.linalg.cholesky((complement + complement.T) / 2.0)
        except np.linalg.LinAlgError:
            return None
        return BorderedFactor(self.readout, schur)


@dataclass(frozen=True, eq=False)
class BorderedFactor:
    """A factored :class:`BorderedSystem`.

    Attributes:
        readout: Of A.
        schur: Cholesky factor of C - B^T A^-1 B, (p, p).
    """

    readout: Elimination
    schur: np.ndarray

    @property
    def size(self) -> int:
        """Of all unknowns."""
        return self.readout.size + len(self.schur)

    def step(self, system: BorderedSystem, lower: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Solution (w, x) of the system: the least of its quadratic form, with x >= lower if that is given.

        With the readout weights eliminated the bounded problem is as small as the parameters are few, so the bounds
        are met exactly and not by a penalty or a transformation.
        """
        half, right = self.reduced(system)
        x = self.of_parameters(right, lower)
        return self.readout_step(half, x), x

    def reduced(self, system: BorderedSystem) -> tuple[np.ndarray, np.ndarray]:
        """Half solved gradient (size,), and the parameters' right-hand side (p,), the readout weights eliminated.

        Nothing pulls at known parameters.
        """
        half, right = self.readout.half_solved(system.gradient)
        return half, right - system.corner_gradient if system.known is None else np.zeros_like(right)

    def readout_step(self, half: np.ndarray, x: np.ndarray) -> np.ndarray:
        """W (size,) that goes with x (p,), from the half solved gradient."""
        return -self.readout.solved(half, x)

    def of_parameters(self, right: np.ndarray, lower: np.ndarray | None = None) -> np.ndarray:
        """X (p,) of that right-hand side, with x >= lower if that is given."""
        x: np.ndarray = self.corner_covariance @ right
        return self._bounded(right, lower) if lower is not None and np.any(x < lower) else x

    def _bounded(self, right: np.ndarray, lower: np.ndarray) -> np.ndarray:
        """The x >= lower (lower <= 0) that makes |R^T x - R^-1 right| least, R R^T the Schur complement.

        With the unbounded x first and R^T = Q T, T upper triangular, the others are a non-negative least-squares
        problem in the rows of T below. Lawson and Hanson's method ends at its solution; scipy's bounded one (bvls)
        stops short where a freed variable is blocked at once.
        """
        lower, unit = np.minimum(lower, 0.0), 1.0 / np.linalg.norm(self.schur, axis=1)
        order = np.argsort(np.isfinite(lower), kind="stable")
        free, bound = np.split(order, [int(np.isinf(lower).sum())])
        q, t = np.linalg.qr((self.schur.T * unit)[:, order])
        target = q.T @ solve_triangular(self.schur, right, lower=True)
        n, least = len(free), lower[bound] / unit[bound]
        above, _ = nnls(t[n:, n:], target[n:] - t[n:, n:] @ least, maxiter=NNLS_STEPS * len(order))
        x = np.empty(len(order))
        x[bound] = lower[bound] + unit[bound] * above
        x[free] = unit[free] * solve_triangular(t[:n, :n], target[:n] - t[:n, n:] @ (least + above))
        return x

    @property
    def corner_covariance(self) -> np.ndarray:
        """(p, p), covariance of the parameters, readout weights marginalised: the Schur complement's inverse."""
        inverse = solve_triangular(self.schur, np.eye(len(self.schur)), lower=True)
        return inverse.T @ inverse

    @property
    def readout_log_determinant(self) -> float:
        """Logarithm of the determinant of A."""
        return self.readout.log_determinant

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the whole matrix."""
        return self.readout_log_determinant + self.parameter_log_determinant

    @property
    def parameter_log_determinant(self) -> float:
        """Logarithm of the determinant of the Schur complement."""
        return 2.0 * float(np.log(np.diag(self.schur)).sum())

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
