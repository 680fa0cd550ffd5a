"""Symmetric positive definite systems of many readout weights, with few system parameters as a border.

Bordered systems of several records that share their parameters: each record's band, and one border for all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls
from scipy.sparse import csr_matrix

from pinn_cli.runs.side_by_side import Items
from pinn_cli.training.normal_matrix.dissection import Dissection
from pinn_cli.training.normal_matrix.elimination import Diagonals, Elimination, InBand, Order
from pinn_cli.training.normal_matrix.front_elimination import FrontTree

# Steps that a bounded solution may take per parameter; one or two is the rule.
NNLS_STEPS = 100


# The last one that was worked out: problems that are posed anew, from other starts or with other modes, have the same.
_LAST: deque[tuple[int, FrontTree]] = deque(maxlen=1)


def order_of_elimination(dissection: Dissection, border: csr_matrix) -> Order:
    """Of the weights of a grid and the parameters that a border (size, p) has them touch."""
    if dissection.cheapest.how == "band":
        return InBand(dissection.grid, border.shape[1])
    for largest, tree in _LAST:
        if largest == dissection.largest and tree.grid == dissection.grid and tree.suits(border):
            return tree
    _LAST.append((dissection.largest, FrontTree(dissection.grid, dissection.tree(), border)))
    return _LAST[0][1]


@dataclass(frozen=True, eq=False)
class BorderedSystem:
    """Normal equations [[A, B], [B^T, C]] [w, x] = -[g, h], in float64 on the CPU, where LAPACK is.

    Attributes:
        band: A.
        border: B, (size, p).
        corner: C, (p, p).
        gradient: g, (size,).
        corner_gradient: h, (p,).
        order: In which the readout weights are eliminated.
    """

    band: Diagonals
    border: csr_matrix
    corner: np.ndarray
    gradient: np.ndarray
    corner_gradient: np.ndarray
    order: Order

    def eliminated(self, damping: float = 0.0) -> Eliminated | None:
        """The readout weights eliminated, the diagonal times 1 + ``damping``; None if A is not positive definite."""
        readout = self.order.eliminated(self.band, self.border, damping)
        if readout is None:
            return None
        schur = self.corner - readout.border_gram
        schur[np.diag_indices_from(schur)] += damping * np.diag(self.corner)
        return Eliminated(readout, schur)

    def readout_step(self) -> np.ndarray | None:
        """W (size,) of the solution with the parameters held; None if A is not positive definite."""
        readout = self.order.alone.eliminated(self.band, csr_matrix((self.band.size, 0)))
        return None if readout is None else -readout.solved(readout.half_solved(self.gradient)[0], np.zeros(0))

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

    def following(self, x: np.ndarray) -> np.ndarray:
        """W (size,) that goes with x (p,) from a solution."""
        return -self.readout.solved(np.zeros(self.readout.size), x)


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

    def solved(self, right: np.ndarray, lower: np.ndarray | None = None) -> np.ndarray:
        """(p,), of the Schur complement S the x >= lower that makes x S x - 2 x right least; None: without bounds."""
        x = self.corner_covariance @ right
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

        Drawn from independent standard normals (size + p, count).
        """
        size = self.readout.size
        x = solve_triangular(self.schur, normals[size:], lower=True, trans="T")
        return self.readout.solved(normals[:size], -x), x

    def deviations(self, rows: np.ndarray, by_parameter: np.ndarray) -> np.ndarray:
        """(q,), of linear functions of weights (size, q) and parameters (p, q), with the inverse as covariance."""
        half, taken = self.readout.half_solved(rows)
        through = solve_triangular(self.schur, by_parameter - taken, lower=True)
        deviation: np.ndarray = np.sqrt(np.sum(half**2, axis=0) + np.sum(through**2, axis=0))
        return deviation


@dataclass(frozen=True, eq=False)
class SharedSystem:
    """Normal equations of all records, one as well; those of each stay where the record is.

    Attributes:
        members: Where the records are.
        columns: Of every record, the places of its own parameters among all p.
        systems: A :class:`BorderedSystem` of every record.
        repeated: (p,), what the corners of several records have of the parameters' prior beyond once.
        pull: (p,), the same of their gradients.
        held: (p, p), covariance of parameters that something else determines: they stay where they are; None: nothing
            has.
        motion_alone: Whether the parameters stay where they are all the same.
    """

    members: Items[Any]
    columns: Sequence[np.ndarray]
    systems: Sequence[Any]
    repeated: np.ndarray
    pull: np.ndarray
    held: np.ndarray | None = None
    motion_alone: bool = False

    def factor(self, damping: float = 0.0) -> SharedFactor | None:
        """Cholesky factors with the diagonal scaled to one plus ``damping``; None if not positive definite."""
        eliminated = self.members.keep(BorderedSystem.eliminated, self.systems, [damping] * len(self.systems))
        complements = self.members.map(_complement, eliminated)
        total, determinants = np.zeros((len(self.repeated),) * 2), []
        for columns, complement in zip(self.columns, complements, strict=True):
            if complement is None:
                return None
            total[np.ix_(columns, columns)] += complement[0]
            determinants.append(complement[1])
        total[np.diag_indices_from(total)] -= (1.0 + damping) * self.repeated
        total = total if self.held is None else np.linalg.inv(self.held)
        try:
            schur = np.linalg.cholesky((total + total.T) / 2.0)
        except np.linalg.LinAlgError:
            return None
        return SharedFactor(schur, eliminated, determinants)

    def readout_step(self) -> np.ndarray | None:
        """All readout weights' part of the solution with the parameters held; None if not positive definite."""
        parts = self.members.map(BorderedSystem.readout_step, self.systems)
        steps = [step for step in parts if step is not None]
        return np.concatenate(steps) if len(steps) == len(parts) else None

    def decrease(self, step: tuple[np.ndarray, np.ndarray]) -> float:
        """What the system's own solution (w, x) takes off 2 [g, h] [w, x] + [w, x] H [w, x]."""
        ends = np.cumsum(self.members.map(attrgetter("band.size"), self.systems))
        parts = zip(np.split(step[0], ends[:-1]), (step[1][columns] for columns in self.columns), strict=True)
        return sum(self.members.map(BorderedSystem.decrease, self.systems, list(parts))) + float(self.pull @ step[1])


@dataclass(frozen=True, eq=False)
class SharedFactor(ParameterFactor):
    """A factored :class:`SharedSystem`: the parameters' part, all readout weights eliminated.

    Attributes:
        eliminated: An :class:`Eliminated` of every record, where the record is.
        determinants: Logarithms of the determinants of every record's A.
    """

    eliminated: Sequence[Any]
    determinants: list[float]

    def step(self, system: SharedSystem, lower: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Solution (w, x) of the system: the least of its quadratic form, with x >= lower if that is given.

        With the readout weights eliminated the bounded problem is as small as the parameters are few, so the bounds
        are met exactly and not by a penalty or a transformation. The weights are those of all records, one after the
        other.
        """
        reduced = self._reduced(system)
        right = self._right_hand_side(system, reduced)
        right = np.zeros_like(right) if system.motion_alone or system.held is not None else right
        x = self.solved(right, lower)
        members, parts = system.members, [x[places] for places in system.columns]
        return np.concatenate(members.map(Eliminated.readout_step, self.eliminated, reduced, parts)), x

    def slope(self, system: SharedSystem) -> np.ndarray:
        """(p,), of -1/2 the loss by the parameters, the motion following them."""
        return self._right_hand_side(system, self._reduced(system))

    def following(self, members: Items[Any], columns: Sequence[np.ndarray], x: np.ndarray) -> np.ndarray:
        """How the readout weights (size,) of a solution follow a step x (p,) of its parameters, -A^-1 B x."""
        steps = members.map(Eliminated.following, self.eliminated, [x[places] for places in columns])
        return np.concatenate(steps)

    def _reduced(self, system: SharedSystem) -> Sequence[Any]:
        return system.members.keep(Eliminated.reduced, self.eliminated, system.systems)

    def _right_hand_side(self, system: SharedSystem, reduced: Sequence[Any]) -> np.ndarray:
        right = system.pull.copy()
        for places, part in zip(system.columns, system.members.map(itemgetter(1), reduced), strict=True):
            right[places] += part
        return right

    def schur_of(self, columns: np.ndarray) -> np.ndarray:
        """Cholesky factor of the precision of some parameters, the others integrated out."""
        if np.array_equal(columns, np.arange(len(self.schur))):
            return self.schur
        return np.linalg.cholesky(np.linalg.inv(self.corner_covariance[np.ix_(columns, columns)]))


def _complement(eliminated: Eliminated | None) -> tuple[np.ndarray, float] | None:
    """The Schur complement (p, p), and the logarithm of the determinant of A."""
    return None if eliminated is None else (eliminated.complement, eliminated.readout.log_determinant)
