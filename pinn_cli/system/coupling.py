"""Which unknown functions of time stand in which equation of a structure, and whether its springs hold it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix, hstack, vstack
from scipy.sparse.csgraph import reverse_cuthill_mckee

from pinn_cli.system.incidence import padded
from pinn_cli.system.structure import Structure

# What holds a coordinate that nothing else does, against springs of stiffness one; and how many times less than that
# tether alone would let it move a coordinate may move before it counts as held.
_TETHER, _HELD = 1e-10, 100.0


class Coupling:
    """A sum of terms, one number each: term t adds L[t, i] x_t R[t, j] to the derivative of row i by column j.

    Of a spring L and R are both its row of the incidence; a hidden force enters equations of other functions.

    Args:
        into: L, (T, N), sparse: the equations that a term enters.
        by: R, (T, N): the functions that it is taken by.
        together: Whether all functions are to stand within one equation's reach, so that the covariance of any two of
            them can be had.
    """

    def __init__(self, into: csr_matrix, by: csr_matrix, together: bool = False) -> None:
        self.into, self.by, self.together = csr_matrix(into), csr_matrix(by), together
        self.size = self.into.shape[1]
        self._pattern = csr_matrix(abs(self.into).T @ abs(self.by))

    @cached_property
    def touching(self) -> np.ndarray:
        """(N, F), the terms in each equation, ascending; at the end T, which is none."""
        places, weights = padded(self.into.T.tocsr())
        return np.where(weights == 0, self.into.shape[0], places)

    @cached_property
    def order(self) -> np.ndarray:
        """(N,), the functions such that those that are coupled stand near each other.

        As they come, unless the reverse order of Cuthill and McKee makes a narrower band.
        """
        natural = np.arange(self.size)
        both = csr_matrix(self._pattern + self._pattern.T)
        other = np.asarray(reverse_cuthill_mckee(both, symmetric_mode=True), dtype=np.int64)
        row, column = both.nonzero()
        rank = np.argsort(other)
        return other if np.abs(rank[row] - rank[column]).max() < np.abs(row - column).max() else natural

    @cached_property
    def rank(self) -> np.ndarray:
        """(N,), the place of every function in that order."""
        return np.argsort(self.order)

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """From a function's place in that order to those of the ones in its equation, ascending; 0 is among them."""
        row, column = self._pattern.nonzero()
        return tuple(sorted({0, *(self.rank[column] - self.rank[row]).tolist()}))

    @cached_property
    def neighbours(self) -> np.ndarray:
        """(N, offsets), the functions at those places; N where the order ends."""
        at = self.rank[:, None] + np.array(self.offsets)
        inside = (at >= 0) & (at < len(self.rank))
        return np.where(inside, self.order[np.where(inside, at, 0)], len(self.rank))

    @cached_property
    def by_offset(self) -> np.ndarray:
        """(N, F, offsets), L[t, i] R[t, j]: what term t, which is in equation i, couples it and neighbour j by."""
        terms, n = self.into.shape
        by, into = (
            hstack([vstack([matrix, csr_matrix((1, n))]), csr_matrix((terms + 1, 1))], format="csr")
            for matrix in (self.by, self.into)
        )
        touching = np.repeat(self.touching[:, :, None], len(self.offsets), axis=2)
        neighbours = np.broadcast_to(self.neighbours[:, None], touching.shape)
        equations = np.broadcast_to(np.arange(n)[:, None, None], touching.shape)
        entries = [
            np.asarray(matrix[touching.reshape(-1), column.reshape(-1)]).reshape(touching.shape)
            for matrix, column in ((into, equations), (by, neighbours))
        ]
        return entries[0] * entries[1]

    @cached_property
    def coupled(self) -> np.ndarray:
        """(N, offsets) bool, which of those there are."""
        coupled = np.any(self.by_offset != 0, axis=1)
        coupled[:, self.offsets.index(0)] = True
        return coupled

    @cached_property
    def reach(self) -> int:
        """The furthest distance between places of functions that one equation contains."""
        if self.together:
            return self.size - 1
        offsets = np.array(self.offsets)
        last = np.where(self.coupled, offsets, offsets.min()).max(axis=1)
        first = np.where(self.coupled, offsets, offsets.max()).min(axis=1)
        return int((last - first).max())


def holding(structure: Structure) -> np.ndarray:
    """(C,) bool, connections that have a force where they are stretched, or may have: where a value is unknown."""
    p = structure.parameters_like(np.empty(0))
    count, _ = structure.incidence.shape
    force = structure.connection_force(np.ones(count), np.zeros(count), p)
    holds: np.ndarray = np.isnan(force) | (force != 0)
    holds[structure.memory] = True  # a hidden force holds as well
    return holds


def loose_dofs(structure: Structure) -> list[int]:
    """Coordinates, counted from 0, that can move together without stretching any spring; none where all are held."""
    springs, coupling = structure.incidence.matrix[holding(structure)], Coupling(*[structure.incidence.matrix] * 2)
    # Directions alone: parts of a finite-element model have rows as long as their modes are fast.
    largest = np.maximum(abs(springs).max(axis=1).toarray(), np.finfo(float).tiny)
    springs = csr_matrix(springs.multiply(1.0 / largest))
    rank, n = coupling.rank, structure.coordinates
    # Springs of stiffness one, as a band; where a coordinate is loose its tether alone keeps the factor from zero.
    stiffness = (springs.T @ springs).tocoo()
    row, column = rank[stiffness.row], rank[stiffness.col]
    width = int(np.max(np.abs(row - column), initial=0))
    band = np.zeros((width + 1, n))
    lower = row >= column
    np.add.at(band, ((row - column)[lower], column[lower]), stiffness.data[lower])
    size = float(band[0].max(initial=0.0)) or 1.0
    band[0] += _TETHER * size
    factor = cholesky_banded(band, lower=True)
    # A push that no symmetry hides: what it moves as if nothing but the tether held it is loose.
    push = 1.0 + np.sqrt(np.arange(1.0, n + 1))
    moved = np.abs(cho_solve_banded((factor, True), push)) * size
    return np.sort(coupling.order[moved > push.max() / (_TETHER * _HELD)]).tolist()
