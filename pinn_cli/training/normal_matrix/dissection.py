"""In which order the weights of local features are eliminated: along time, along the structure, or by dissection.

The weights are a grid of features by functions (in the band's order). Two of them are in one row of a residual where
their features are at most ``span`` and their functions at most ``reach`` apart. A part of the grid is eliminated slab
by slab along either axis, or it is cut in two, across either axis, by a separator as wide as that, which is eliminated
after both halves (nested dissection; George 1973). Which of these is cheapest is counted, part by part.

Which unknowns every dense front of an elimination holds, and where their entries come from: no numbers yet.

Multifrontal elimination (Duff and Reid 1983): a front is a small dense matrix of the weights that are eliminated
together and of all that they touch. What their elimination leaves of it is added to the front of the next ones.
Parameters are touched by the weights of their own neighbourhood alone, and are never eliminated here.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

# Places of some rows of a front among those of another: as ranges (first here, first there, how many).
Runs = list[tuple[int, int, int]]
# Of a dense front with k rows that are eliminated and m that are left: cost of an operation in its Cholesky factor
# (k^3 / 3), in the triangular solutions (k^2 m) and in the products (k m^2); of an entry that is filled and added; of
# the front itself. Measured in products.
CHOLESKY, SOLUTION, ENTRY, FRONT = 2.5, 2.5, 60.0, 4e6
# The same of LAPACK's banded factor: of a column, of its square, and of each of its entries for a parameter; up to a
# half width of 64 it goes column by column. The band itself is filled entry by entry.
COLUMN, SQUARE, BORDER, UNBLOCKED, SQUARE_UNBLOCKED = 500.0, 2.0, 40.0, 64, 10.0
# Weights of a slab, and of a part that is not cut any further, at most.
LARGEST_SLAB = 400


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
        band_target, band_source: Which of a factor's numbers come from which values of the band.
        border_target, border_source: The same of the border's.
    """

    def __init__(self, grid: Grid, root: Separated, border: csr_matrix) -> None:
        self.grid, self.border = grid, border
        nodes = _after_their_children(root)
        self.order = np.concatenate([node.weights for node, _ in nodes])
        self.rank = np.argsort(self.order)
        self._distances = grid.distances
        distances = np.abs(self._distances[0] * grid.functions + self._distances[1])
        self.offsets = grid.offsets
        self._line = np.searchsorted(self.offsets, distances)
        self.fronts: list[Front] = []
        of_band, of_border = [[np.zeros((2, 0), dtype=np.int32)] for _ in range(2)]
        at = first = stop = 0
        for node, children in nodes:
            start, stop = stop, stop + len(node.weights)
            front, *found = self._front(start, stop, children, at, first)
            self.fronts.append(front)
            at, first = at + front.entries, front.band.stop
            # In as few bytes as they fit into: of a long record places take as much room as the numbers themselves.
            furthest = max(at, self.size * len(self.offsets), border.nnz)
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
        """The same elimination without a border."""
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
        """Whether another border has its entries at the same places."""
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


# The last one that was worked out: problems that are posed anew, from other starts or with other modes, have the same.
_LAST: deque[tuple[int, FrontTree]] = deque(maxlen=1)


def order_of_elimination(dissection: Dissection, border: csr_matrix) -> FrontTree | InBand:
    """Of the weights of a grid and the parameters that a border (size, p) has them touch."""
    if dissection.cheapest.how == "band":
        return InBand(dissection.grid, border.shape[1])
    for largest, tree in _LAST:
        if largest == dissection.largest and tree.grid == dissection.grid and tree.suits(border):
            return tree
    _LAST.append((dissection.largest, FrontTree(dissection.grid, dissection.tree(), border)))
    return _LAST[0][1]


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
    breaks = np.flatnonzero((np.diff(places) != 1) | (places[1:] == end)) + 1
    starts = np.concatenate(([0], breaks)) if len(places) else places
    lengths = np.diff(np.append(starts, len(places)))
    return [(int(s), int(places[s]), int(n)) for s, n in zip(starts, lengths, strict=True)]


@dataclass(frozen=True)
class Grid:
    """The weights, and which of them meet in a row.

    Attributes:
        features: Of one function.
        functions: In the band's order.
        span: The furthest that two features of one row are apart.
        reach: The furthest that two functions of one row are apart.
        parameters: In the border, of all functions together.
    """

    features: int
    functions: int
    span: int
    reach: int
    parameters: int

    @property
    def size(self) -> int:
        """Weights."""
        return self.features * self.functions

    @property
    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """Of two weights of one row in features and in functions, all that there are."""
        along, across = np.arange(-self.span, self.span + 1), np.arange(-self.reach, self.reach + 1)
        features, functions = np.meshgrid(along, across, indexing="ij")
        return features.reshape(-1), functions.reshape(-1)

    @property
    def offsets(self) -> np.ndarray:
        """(K,), ascending, the diagonals of the band that hold something."""
        features, functions = self.distances
        offsets: np.ndarray = np.unique(np.abs(features * self.functions + functions))
        return offsets

    @property
    def in_band(self) -> Choice:
        """All of them one after the other."""
        width, lines = int(self.offsets[-1]), len(self.offsets)
        square = SQUARE_UNBLOCKED if width <= UNBLOCKED else SQUARE
        column = (COLUMN + square * width + BORDER * self.parameters) * width + ENTRY * lines
        return Choice(self.size * column, float(self.size * (width + 1 + self.parameters)), "band", "features", 1)


@dataclass(frozen=True, eq=False)
class InBand:
    """All weights one after the other, as they stand in the band.

    Attributes:
        grid: Of the weights.
        parameters: In the border.
    """

    grid: Grid
    parameters: int

    @cached_property
    def offsets(self) -> np.ndarray:
        """See :attr:`Grid.offsets`."""
        return self.grid.offsets

    @property
    def half_width(self) -> int:
        """Of the band."""
        return int(self.offsets[-1])

    @property
    def alone(self) -> InBand:
        """The same elimination without a border."""
        return InBand(self.grid, 0)

    def suits(self, border: csr_matrix) -> bool:
        """Whether another border may stand in the place of this one."""
        return bool(border.shape[1] == self.parameters)


class Part(NamedTuple):
    """A rectangle of the grid, and at which of its sides there is more of it.

    Attributes:
        features: How many.
        functions: How many.
        before, after: Whether other features border on it.
        below, above: Whether other functions do.
    """

    features: int
    functions: int
    before: bool
    after: bool
    below: bool
    above: bool


@dataclass(frozen=True)
class Separated:
    """Weights that are eliminated together, once all others that stand before them in the tree are.

    Attributes:
        weights: Their places in the band, in the order of elimination.
        children: What is eliminated before.
    """

    weights: np.ndarray
    children: tuple[Separated, ...]


class Choice(NamedTuple):
    """How a part is eliminated.

    Attributes:
        cost: In operations of a matrix product.
        entries: Of its factor.
        how: ``leaf``, ``slabs``, ``halves`` or ``band``.
        axis: Along which it is cut, ``features`` or ``functions``.
        length: Of a slab along it.
    """

    cost: float
    entries: float
    how: str
    axis: str
    length: int


def fronts(count: int, eliminated: float, remaining: float) -> tuple[float, float]:
    """Cost and entries of the factor, of so many fronts with so many rows that are eliminated and that are left."""
    k, m = eliminated, remaining
    cost = CHOLESKY * k**3 / 3 + SOLUTION * k**2 * m + k * m**2 + ENTRY * (k + m) ** 2 + FRONT
    return count * cost, count * k * (k + m)


class Dissection:
    """The cheapest order of elimination of a grid.

    Args:
        grid: Of the weights.
        largest: Weights of a slab, and of a part that is not cut any further, at most.
    """

    def __init__(self, grid: Grid, largest: int = LARGEST_SLAB) -> None:
        self.grid, self.largest = grid, largest
        self._best = lru_cache(None)(self._cheapest)
        self._whole = Part(grid.features, grid.functions, False, False, False, False)

    @property
    def best(self) -> Choice:
        """Of all weights."""
        return self._best(self._whole)

    @property
    def cheapest(self) -> Choice:
        """Of all weights, or all of them in their band."""
        return min(self.best, self.grid.in_band)

    def tree(self) -> Separated:
        """The order of the best."""
        return self._tree(self._whole, 0, 0)

    def _thick(self, axis: str) -> int:
        """What a cut across an axis takes to separate its sides."""
        return self.grid.span if axis == "features" else self.grid.reach

    def _remaining(self, part: Part, features: float, functions: float) -> float:
        """Weights and parameters around a part, of which so many features and functions are eliminated."""
        grid = self.grid
        across, along = grid.reach * (part.below + part.above), grid.span * (part.before + part.after)
        parameters = grid.parameters * min(1.0, (functions + 2 * grid.reach) / grid.functions)
        return along * (functions + across) + features * across + parameters

    def _cheapest(self, part: Part) -> Choice:
        size, around = part.features * part.functions, self._remaining(part, part.features, part.functions)
        options = [slabs for axis in ("features", "functions") for slabs in self._slabs(part, axis)]
        if size <= self.largest or not options:
            options.append(Choice(*fronts(1, size, around), "leaf", "features", 0))
        for axis in ("features", "functions"):
            length, thick = getattr(part, axis), self._thick(axis)
            if thick > 0 and length >= 3 * thick + 2 and size > self.largest:
                cost, entries = fronts(1, thick * size / length, around)
                halves = [self._best(half) for half in self._halves(part, axis)]
                cost, entries = cost + sum(x.cost for x in halves), entries + sum(x.entries for x in halves)
                options.append(Choice(cost, entries, "halves", axis, 0))
        return min(options)

    def _slabs(self, part: Part, axis: str) -> Iterator[Choice]:
        """Slab after slab along an axis, of several lengths."""
        total, length = getattr(part, axis), 1
        across = part.features * part.functions // total
        open_end = part._replace(**{"after" if axis == "features" else "above": True})
        # Along the features there is always one; all features of a function are one where they are few.
        most = max(self.largest, across) if axis == "features" else self.largest
        while length <= total and length * across <= most:
            # Half of the slabs, on average, have been eliminated; the next ones are left as well.
            done = {axis: min(total, total / 2 + self._thick(axis))}
            remaining = self._remaining(open_end, **{"features": part.features, "functions": part.functions} | done)
            yield Choice(*fronts(math.ceil(total / length), length * across, remaining), "slabs", axis, length)
            length *= 2

    def _halves(self, part: Part, axis: str) -> tuple[Part, Part]:
        if axis == "features":
            first = (part.features - self.grid.span) // 2
            rest = part.features - self.grid.span - first
            return part._replace(features=first, after=True), part._replace(features=rest, before=True)
        first = (part.functions - self.grid.reach) // 2
        rest = part.functions - self.grid.reach - first
        return part._replace(functions=first, above=True), part._replace(functions=rest, below=True)

    def _tree(self, part: Part, feature: int, function: int) -> Separated:
        """The order in a part whose first feature and function are given."""
        _, _, how, axis, length = self._best(part)
        if how == "leaf":
            return Separated(self._weights(part, feature, function, by_feature=True), ())
        if how == "slabs":
            tree: Separated | None = None
            for start in range(0, getattr(part, axis), length):
                slab = part._replace(**{axis: min(length, getattr(part, axis) - start)})
                at = (feature + start, function) if axis == "features" else (feature, function + start)
                weights = self._weights(slab, *at, by_feature=axis == "features")
                tree = Separated(weights, () if tree is None else (tree,))
            assert tree is not None
            return tree
        first, second = self._halves(part, axis)
        if axis == "features":
            middle = part._replace(features=self.grid.span)
            between = self._weights(middle, feature + first.features, function, by_feature=False)
            after = feature + first.features + self.grid.span, function
        else:
            middle = part._replace(functions=self.grid.reach)
            between = self._weights(middle, feature, function + first.functions, by_feature=True)
            after = feature, function + first.functions + self.grid.reach
        return Separated(between, (self._tree(first, feature, function), self._tree(second, *after)))

    def _weights(self, part: Part, feature: int, function: int, by_feature: bool) -> np.ndarray:
        """Places in the band of a part's weights, its longer side outermost, so that halves are contiguous."""
        at = np.arange(feature, feature + part.features)[:, None] * self.grid.functions
        places = at + np.arange(function, function + part.functions)
        return (places if by_feature else places.T).reshape(-1)
