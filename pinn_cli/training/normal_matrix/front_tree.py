"""Which unknowns every dense front of an elimination holds, and where their entries come from: no numbers yet.

Multifrontal elimination (Duff and Reid 1983): a front is a small dense matrix of the weights that are eliminated
together and of all that they touch. What their elimination leaves of it is added to the front of the next ones.
Parameters are touched by the weights of their own neighbourhood alone, and are never eliminated here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.dissection import Grid, Separated

# Places of some rows of a front among those of another: as ranges (first here, first there, how many).
Runs = list[tuple[int, int, int]]


@dataclass(eq=False)
class Front:
    """One dense front: rows that are eliminated, weights that are left, and parameters.

    Attributes:
        start, stop: Which weights are eliminated, as places in the order of elimination.
        left: (m,), the weights that are left, likewise, ascending.
        parameters: (q,), ascending.
        band_column, band_row, band_source: Which entries of the front are in the band, and which of the band's values
            each is.
        border_column, border_row, border_source: The same of the border's.
        children: Fronts that are added to this one.
        runs: Of its own rows that are left, where they stand in the front that it is added to; none holds both rows
            that are eliminated there and others.
    """

    start: int
    stop: int
    left: np.ndarray
    parameters: np.ndarray
    band_column: np.ndarray
    band_row: np.ndarray
    band_source: np.ndarray
    border_column: np.ndarray
    border_row: np.ndarray
    border_source: np.ndarray
    children: list[int]
    runs: Runs = field(default_factory=list)

    @property
    def eliminated(self) -> int:
        """How many weights."""
        return self.stop - self.start

    @property
    def remaining(self) -> int:
        """Rows of the front that are not eliminated."""
        return len(self.left) + len(self.parameters)

    @property
    def entries(self) -> int:
        """Numbers of its part of the factor: (k, k) among its k weights, and (remaining, k) below."""
        return self.eliminated * (self.eliminated + self.remaining)

    def places(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Of entries in the k columns that are eliminated, where they stand in those, each part in Fortran's order."""
        k = self.eliminated
        return np.where(row < k, column * k + row, k * k + column * self.remaining + row - k)


class FrontTree:
    """All fronts of an elimination, every one after those that are added to it.

    Args:
        grid: Of the weights.
        root: The order of elimination.
        border: Of the parameters (size, p); of its entries those that are kept count, whatever their value.

    Attributes:
        order: (size,), the weights' places in the band in the order of elimination.
        offsets: (K,), ascending, the diagonals of the band that hold something.
        fronts: All of them.
        band_target, band_source, border_target, border_source: Which of a factor's numbers come from which values of
            the band and of the border.
    """

    def __init__(self, grid: Grid, root: Separated, border: csr_matrix) -> None:
        self.grid, self.border, self._root = grid, border, root
        every = _after_their_children(root)
        self.order = np.concatenate([node.weights for node, _ in every])
        self.rank = np.argsort(self.order)
        features, functions = np.meshgrid(
            np.arange(-grid.span, grid.span + 1), np.arange(-grid.reach, grid.reach + 1), indexing="ij"
        )
        self._apart = features.reshape(-1), functions.reshape(-1)
        beside = np.abs(self._apart[0] * grid.functions + self._apart[1])
        self.offsets = np.unique(beside)
        self._line = np.searchsorted(self.offsets, beside)
        self.fronts: list[Front] = []
        stop = 0
        for node, children in every:
            start, stop = stop, stop + len(node.weights)
            self.fronts.append(self._front(start, stop, children))
        self._place_children()
        starts = np.cumsum([0] + [front.entries for front in self.fronts])[:-1]
        pairs = list(zip(self.fronts, starts, strict=True))
        self.band_target = np.concatenate([at + f.places(f.band_column, f.band_row) for f, at in pairs])
        self.band_source = np.concatenate([front.band_source for front in self.fronts])
        self.border_target = np.concatenate([at + f.places(f.border_column, f.border_row) for f, at in pairs])
        self.border_source = np.concatenate([front.border_source for front in self.fronts])

    @property
    def size(self) -> int:
        """Weights."""
        return len(self.order)

    @cached_property
    def alone(self) -> FrontTree:
        """The same elimination without a border."""
        return FrontTree(self.grid, self._root, csr_matrix((self.size, 0)))

    @property
    def entries(self) -> int:
        """Numbers of a factor."""
        return sum(front.entries for front in self.fronts)

    def suits(self, border: csr_matrix) -> bool:
        """Whether another border has its entries at the same places."""
        mine = self.border
        return np.array_equal(mine.indptr, border.indptr) and np.array_equal(mine.indices, border.indices)

    def _front(self, start: int, stop: int, children: list[int]) -> Front:
        weights = self.order[start:stop]
        column, row, source = self._neighbours(weights, start)
        first, last = self.border.indptr[weights], self.border.indptr[weights + 1]
        counts = last - first
        entries = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        inherited = [self.fronts[child] for child in children]
        left = np.unique(np.concatenate([row, *(child.left for child in inherited)]))
        left = left[left >= stop]
        touched = self.border.indices[entries]
        parameters = np.unique(np.concatenate([touched, *(child.parameters for child in inherited)]))
        k = stop - start
        at = np.where(row < stop, row - start, k + np.searchsorted(left, row))
        of_border = np.repeat(np.arange(k), counts), k + len(left) + np.searchsorted(parameters, touched)
        return Front(start, stop, left, parameters, column, at, source, *of_border, entries.astype(np.int64), children)

    def _neighbours(self, weights: np.ndarray, start: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Entries of the band in the columns of weights that are eliminated: column, row, and which of its values.

        The column counts from the first of them, the row in the order of elimination; the lower half alone.
        """
        grid, size = self.grid, self.size
        feature, function = np.divmod(weights, grid.functions)
        feature, function = feature[:, None] + self._apart[0], function[:, None] + self._apart[1]
        inside = (feature >= 0) & (feature < grid.features) & (function >= 0) & (function < grid.functions)
        column, which = np.nonzero(inside)
        other = (feature * grid.functions + function)[inside]
        row = self.rank[other]
        kept = row >= start + column
        column, which, other, row = column[kept], which[kept], other[kept], row[kept]
        return column, row, self._line[which] * size + np.minimum(other, weights[column])

    def _place_children(self) -> None:
        for front in self.fronts:
            for number in front.children:
                child = self.fronts[number]
                k = front.eliminated
                weights = np.where(child.left < front.stop, child.left - front.start, k)
                beyond = child.left >= front.stop
                weights[beyond] += np.searchsorted(front.left, child.left[beyond])
                parameters = k + len(front.left) + np.searchsorted(front.parameters, child.parameters)
                child.runs = _runs(np.concatenate((weights, parameters)), k)


def _after_their_children(root: Separated) -> list[tuple[Separated, list[int]]]:
    """All nodes of a tree in such an order, each with the places of its children in it."""
    order, waiting = [], [root]
    while waiting:
        node = waiting.pop()
        order.append(node)
        waiting += node.children
    order.reverse()
    place = {id(node): i for i, node in enumerate(order)}
    return [(node, [place[id(child)] for child in node.children]) for node in order]


def _runs(places: np.ndarray, end: int) -> Runs:
    """Ascending places as ranges, none of which goes on beyond an end."""
    apart = np.flatnonzero((np.diff(places) != 1) | (places[1:] == end)) + 1
    starts = np.concatenate(([0], apart)) if len(places) else places
    lengths = np.diff(np.append(starts, len(places)))
    return [(int(s), int(places[s]), int(n)) for s, n in zip(starts, lengths, strict=True)]
