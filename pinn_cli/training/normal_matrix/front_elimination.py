"""The readout weights eliminated front by front: multifrontal elimination (Duff and Reid 1983).

A front is a small dense matrix of the weights that are eliminated together and of all that they touch. What their
elimination leaves of it is added to the front of the next ones. Parameters are touched by the weights of their own
neighbourhood alone, and are never eliminated here.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.dissection import Grid, Nodes
from pinn_cli.training.normal_matrix.elimination import (
    Diagonals,
    Elimination,
    Order,
    root_of_inverse,
    triangular_root,
)

# Places of some rows of a front among those of another: as ranges (first here, first there, how many).
Runs = list[tuple[int, int, int]]
# Entries that are placed at once: little enough for the caches, and for no copy of the whole.
ENTRIES_AT_ONCE = 1_000_000


@dataclass(eq=False)
class Front:
    """One dense front: rows that are eliminated, weights that are left, and parameters.

    Attributes:
        start, stop: Which weights are eliminated, as places in the order of elimination.
        boundary: (m,), the weights that are left, likewise, ascending.
        parameters: (q,), ascending.
        at: The first of its numbers in the factor.
        band: Which of the tree's entries of the band are its own.
        children: Fronts that are added to this one.
        runs: Of its own rows that are left, where they stand in the front that it is added to; none holds both rows
            that are eliminated there and others.
    """

    start: int
    stop: int
    boundary: np.ndarray
    parameters: np.ndarray
    at: int
    band: slice
    children: list[int]
    runs: Runs = field(default_factory=list)

    @property
    def eliminated(self) -> int:
        """How many weights."""
        return self.stop - self.start

    @property
    def remaining(self) -> int:
        """Rows of the front that are not eliminated."""
        return len(self.boundary) + len(self.parameters)

    @property
    def entries(self) -> int:
        """Numbers of its part of the factor: (k, k) among its k weights, and (remaining, k) below."""
        return self.eliminated * (self.eliminated + self.remaining)

    def places(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Of entries in the k columns that are eliminated, where they stand in the factor.

        Its part among the k weights comes first, then the part below, each in Fortran's order.
        """
        k = self.eliminated
        return self.at + np.where(row < k, column * k + row, k * k + column * self.remaining + row - k)

    def cells(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Column and row of entries that stand at some places in the factor."""
        k, place = self.eliminated, places - self.at
        below = place >= k * k
        height = np.where(below, max(self.remaining, 1), k)
        column, row = np.divmod(place - below * k * k, height)
        return column, row + below * k


class FrontTree(Order):
    """All fronts of an elimination, every one after those that are added to it.

    Args:
        grid: Of the weights.
        nodes: The order of elimination.
        border: Of the parameters (size, p); of its entries those that are kept count, whatever their value.

    Attributes:
        order: (size,), the weights' places in the band in the order of elimination.
        fronts: All of them.
        band_target, band_source: Which of a factor's numbers come from which values of the band.
        border_target, border_source: The same of the border's.
    """

    def __init__(self, grid: Grid, nodes: Nodes, border: csr_matrix) -> None:
        self.grid, self.border = grid, border
        self.order = np.concatenate([weights for weights, _ in nodes])
        self.rank = np.argsort(self.order)
        self._distances = grid.distances
        distances = np.abs(self._distances[0] * grid.functions + self._distances[1])
        self._line = np.searchsorted(grid.offsets, distances)
        self.fronts: list[Front] = []
        of_band, of_border = [[np.zeros((2, 0), dtype=np.int32)] for _ in range(2)]
        at = first = stop = 0
        for weights, children in nodes:
            start, stop = stop, stop + len(weights)
            front, *found = self._front(start, stop, children, at, first)
            self.fronts.append(front)
            at, first = at + front.entries, front.band.stop
            # In as few bytes as they fit into: of a long record places take as much room as the numbers themselves.
            furthest = max(at, self.size * len(grid.offsets), border.nnz)
            for all_entries, entries in zip((of_band, of_border), found, strict=True):
                all_entries.append(np.array(entries, np.int32 if furthest < np.iinfo(np.int32).max else np.int64))
        self._place_children()
        self.band_target, self.band_source = np.concatenate(of_band, axis=1)
        self.border_target, self.border_source = np.concatenate(of_border, axis=1)

    @property
    def size(self) -> int:
        """Weights."""
        return len(self.order)

    @cached_property
    def alone(self) -> FrontTree:
        """See :attr:`Order.alone`."""
        out, at, nothing = copy(self), 0, np.zeros(0, dtype=np.int64)
        out.border, out.fronts = csr_matrix((self.size, 0)), []
        out.border_target = out.border_source = nothing
        out.band_target = np.empty_like(self.band_target)
        for front in self.fronts:
            own = Front(front.start, front.stop, front.boundary, nothing, at, front.band, front.children)
            out.band_target[own.band] = own.places(*front.cells(self.band_target[front.band]))
            out.fronts.append(own)
            at += own.entries
        out._place_children()
        return out

    @property
    def entries(self) -> int:
        """Numbers of a factor."""
        return sum(front.entries for front in self.fronts)

    def suits(self, border: csr_matrix) -> bool:
        """See :meth:`Order.suits`."""
        expected = self.border
        return np.array_equal(expected.indptr, border.indptr) and np.array_equal(expected.indices, border.indices)

    def _front(
        self, start: int, stop: int, children: list[int], at: int, first_entry: int
    ) -> tuple[Front, tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """A front, and of its entries of the band and of the border the places and which of the values each is."""
        weights = self.order[start:stop]
        column, row, source = self._neighbours(weights, start)
        first, last = self.border.indptr[weights], self.border.indptr[weights + 1]
        counts = last - first
        entries = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        inherited = [self.fronts[child] for child in children]
        boundary = np.unique(np.concatenate([row, *(child.boundary for child in inherited)]))
        boundary = boundary[boundary >= stop]
        touched = self.border.indices[entries]
        parameters = np.unique(np.concatenate([touched, *(child.parameters for child in inherited)]))
        k, m, own = stop - start, len(boundary), slice(first_entry, first_entry + len(row))
        front = Front(start, stop, boundary, parameters, at, own, children)
        of_band = front.places(column, np.where(row < stop, row - start, k + np.searchsorted(boundary, row)))
        of_border = front.places(np.repeat(np.arange(k), counts), k + m + np.searchsorted(parameters, touched))
        return front, (of_band, source), (of_border, entries)

    def _neighbours(self, weights: np.ndarray, start: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Entries of the band in the columns of weights that are eliminated: column, row, and which of its values.

        The column counts from the first of them, the row in the order of elimination; the lower half alone.
        """
        grid, size = self.grid, self.size
        feature, function = np.divmod(weights, grid.functions)
        feature, function = feature[:, None] + self._distances[0], function[:, None] + self._distances[1]
        inside = (feature >= 0) & (feature < grid.features) & (function >= 0) & (function < grid.functions)
        column, which = np.nonzero(inside)
        neighbour = (feature * grid.functions + function)[inside]
        row = self.rank[neighbour]
        kept = row >= start + column
        column, which, neighbour, row = column[kept], which[kept], neighbour[kept], row[kept]
        return column, row, self._line[which] * size + np.minimum(neighbour, weights[column])

    def _factored(self, scale: np.ndarray, values: np.ndarray, border: csr_matrix) -> FrontElimination | None:
        flat = values.reshape(-1)
        # One piece of memory, which the system takes back whole, and in which the columns are eliminated.
        kept = np.zeros(self.entries)
        for first in range(0, len(self.band_target), ENTRIES_AT_ONCE):
            part = slice(first, first + ENTRIES_AT_ONCE)
            kept[self.band_target[part]] = flat[self.band_source[part]]
        kept[self.border_target] = border.data[self.border_source]
        pivots: list[np.ndarray] = []
        below: list[np.ndarray] = []
        gram = np.zeros((border.shape[1],) * 2)
        waiting: dict[int, np.ndarray] = {}
        for number, front in enumerate(self.fronts):
            k, m, at = front.eliminated, front.remaining, front.at
            pivot = kept[at : at + k * k].reshape((k, k), order="F")
            under = kept[at + k * k : at + front.entries].reshape((m, k), order="F")
            update = np.zeros((m, m), order="F")
            for child in (child for child in front.children if child in waiting):
                _add(pivot, under, update, waiting.pop(child), self.fronts[child].runs)
            if dpotrf(pivot, lower=1, clean=0, overwrite_a=1)[1]:
                return None
            pivots.append(pivot)
            below.append(under)
            if m:
                dtrsm(1.0, pivot, under, side=1, lower=1, trans_a=1, overwrite_b=1)
                waiting[number] = dsyrk(-1.0, under, beta=1.0, c=update, lower=1, overwrite_c=1)
        for number, update in waiting.items():  # of the roots: parameters alone
            parameters = self.fronts[number].parameters
            gram[np.ix_(parameters, parameters)] -= update
        return FrontElimination(self, scale, pivots, below, np.tril(gram) + np.tril(gram, -1).T)

    def _place_children(self) -> None:
        for front in self.fronts:
            for number in front.children:
                child = self.fronts[number]
                k = front.eliminated
                weights = np.where(child.boundary < front.stop, child.boundary - front.start, k)
                beyond = child.boundary >= front.stop
                weights[beyond] += np.searchsorted(front.boundary, child.boundary[beyond])
                parameters = k + len(front.boundary) + np.searchsorted(front.parameters, child.parameters)
                child.runs = _runs(np.concatenate((weights, parameters)), k)


def _runs(places: np.ndarray, end: int) -> Runs:
    """Ascending places as ranges, none of which goes on beyond an end."""
    breaks = np.flatnonzero((np.diff(places) != 1) | (places[1:] == end)) + 1
    starts = np.concatenate(([0], breaks)) if len(places) else places
    lengths = np.diff(np.append(starts, len(places)))
    return [(int(s), int(places[s]), int(n)) for s, n in zip(starts, lengths, strict=True)]


@dataclass(frozen=True, eq=False)
class FrontElimination(Elimination):
    """Front by front.

    Attributes:
        tree: Of the fronts.
        scale: See :class:`Elimination`.
        pivots: Of every front, L among the weights that are eliminated, (k, k); above its diagonal anything.
        below: Of every front, the part of L below those, and of the half solved border: (m + q, k).
        border_gram: See :class:`Elimination`.
    """

    tree: FrontTree
    scale: np.ndarray
    pivots: list[np.ndarray]
    below: list[np.ndarray]
    border_gram: np.ndarray

    @property
    def operations(self) -> float:
        """See :attr:`Elimination.operations`."""
        sizes = np.array([under.shape for under in self.below], dtype=float)
        remaining, k = sizes.T
        return float(np.sum(k * (k + 1) * (2 * k + 1) / 6 + remaining * k**2 + k * remaining**2))

    @property
    def _log_pivots(self) -> float:
        return sum(float(np.log(np.diagonal(pivot)).sum()) for pivot in self.pivots)

    def half_solved(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Elimination.half_solved`."""
        columns = right if right.ndim == 2 else right[:, None]
        half = np.ascontiguousarray((columns / self.scale[:, None])[self.tree.order])
        taken = np.zeros((len(self.border_gram), columns.shape[1]))
        for front, pivot, under in zip(self.tree.fronts, self.pivots, self.below, strict=True):
            block, m = half[front.start : front.stop], len(front.boundary)
            if not block.any():  # functions of the last weights alone begin late
                continue
            dtrsm(1.0, pivot, block.T, side=1, lower=1, trans_a=1, overwrite_b=1)
            moved = under @ block
            half[front.boundary] -= moved[:m]
            taken[front.parameters] += moved[m:]
        return half.reshape(right.shape), taken.reshape(len(taken), *right.shape[1:])

    def solved(self, half: np.ndarray, x: np.ndarray) -> np.ndarray:
        """See :meth:`Elimination.solved`."""
        columns = np.array(half if half.ndim == 2 else half[:, None], order="C")
        by = x.reshape(len(x), columns.shape[1])
        for front, pivot, under in zip(
            reversed(self.tree.fronts), reversed(self.pivots), reversed(self.below), strict=True
        ):
            block, m = columns[front.start : front.stop], len(front.boundary)
            block -= under[:m].T @ columns[front.boundary]
            block += under[m:].T @ by[front.parameters]
            dtrsm(1.0, pivot, block.T, side=1, lower=1, overwrite_b=1)
        out = np.empty_like(columns)
        out[self.tree.order] = columns
        return (out / self.scale[:, None]).reshape(half.shape)

    def inverse(self) -> Diagonals:
        """See :meth:`Elimination.inverse`."""
        offsets = self.tree.grid.offsets
        out = np.zeros((len(offsets), self.tree.size))
        flat = out.reshape(-1)
        roots: dict[int, np.ndarray] = {}
        for number in reversed(range(len(self.tree.fronts))):
            front, pivot = self.tree.fronts[number], self.pivots[number]
            m = len(front.boundary)
            boundary_root = roots.pop(number) if m else np.zeros((0, 0))
            root = root_of_inverse(pivot, self.below[number][:m], boundary_root)
            whole = root @ root.T
            column, row = front.cells(self.tree.band_target[front.band])
            flat[self.tree.band_source[front.band]] = whole[row, column]
            for child in (child for child in front.children if len(self.tree.fronts[child].boundary)):
                roots[child] = _taken(root, self.tree.fronts[child])
        return Diagonals(offsets, out).over(self.scale)


def _add(pivot: np.ndarray, under: np.ndarray, update: np.ndarray, more: np.ndarray, runs: Runs) -> None:
    """Add the lower half of what is left of a front to the parts of the front that it belongs to."""
    k = len(pivot)
    for i, (row, above, rows) in enumerate(runs):
        for column, target, columns in runs[: i + 1]:
            part, at = (update, k) if target >= k else (under, 0) if above >= k else (pivot, 0)
            down = above if part is pivot else above - k
            part[down : down + rows, target - at : target - at + columns] += more[
                row : row + rows, column : column + columns
            ]


def _taken(root: np.ndarray, child: Front) -> np.ndarray:
    """(m, r), a root of what is left of another front, without parameters, from that of the front it belongs to."""
    index = np.concatenate([np.arange(target, target + n) for _, target, n in child.runs])[: len(child.boundary)]
    return triangular_root(root[index])
