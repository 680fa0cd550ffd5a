"""In which order the weights of local features are eliminated: along time, along the structure, or by dissection.

The weights are a grid of features by functions (in the band's order). Two of them are in one row of a residual where
their features are at most ``span`` and their functions at most ``reach`` apart. A part of the grid is eliminated slab
by slab along either axis, or it is cut in two, across either axis, by a separator as wide as that, which is eliminated
after both halves (nested dissection; George 1973). Which of these is cheapest is counted, part by part.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

# Of a dense front with k rows that are eliminated and m that are left: cost of an operation in its Cholesky factor
# (k^3 / 3), in the triangular solutions (k^2 m) and in the products (k m^2); of an entry that is filled and added; of
# the front itself. Measured in products.
CHOLESKY, SOLUTION, ENTRY, FRONT = 2.5, 2.5, 60.0, 4e6
# The same of LAPACK's banded factor: of a column, of its square, and of each of its entries for a parameter; up to a
# half width of 64 it goes column by column. The band itself is filled entry by entry.
COLUMN, SQUARE, BORDER, UNBLOCKED, SQUARE_UNBLOCKED = 500.0, 2.0, 40.0, 64, 10.0
# Weights of a slab, and of a part that is not cut any further, at most.
LARGEST_SLAB = 400
# Weights that are eliminated together, as places in the band, and the numbers of those that are eliminated just before.
Nodes = list[tuple[np.ndarray, list[int]]]


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

    @cached_property
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

    def tree(self) -> Nodes:
        """The order of the best."""
        nodes: Nodes = []
        self._add_to(nodes, self._whole, 0, 0)
        return nodes

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
        length, thick = getattr(part, axis), self._thick(axis)
        first = (length - thick) // 2
        ahead, behind = ("after", "before") if axis == "features" else ("above", "below")
        rest = length - thick - first
        return part._replace(**{axis: first, ahead: True}), part._replace(**{axis: rest, behind: True})

    def _add_to(self, nodes: Nodes, part: Part, feature: int, function: int) -> int:
        """Add the order in a part whose first feature and function are given, and say the number of its last node."""
        _, _, how, axis, length = self._best(part)
        children: list[int] = []

        def at(along: int) -> tuple[int, int]:
            return (feature + along, function) if axis == "features" else (feature, function + along)

        if how == "leaf":
            nodes.append((self._weights(part, feature, function, by_feature=True), children))
        elif how == "slabs":
            for start in range(0, getattr(part, axis), length):
                slab = part._replace(**{axis: min(length, getattr(part, axis) - start)})
                nodes.append((self._weights(slab, *at(start), by_feature=axis == "features"), children))
                children = [len(nodes) - 1]
        else:
            (first, second), thick = self._halves(part, axis), self._thick(axis)
            cut, middle = getattr(first, axis), part._replace(**dict[str, Any]({axis: thick}))
            children = [
                self._add_to(nodes, first, feature, function),
                self._add_to(nodes, second, *at(cut + thick)),
            ]
            nodes.append((self._weights(middle, *at(cut), by_feature=axis == "functions"), children))
        return len(nodes) - 1

    def _weights(self, part: Part, feature: int, function: int, by_feature: bool) -> np.ndarray:
        """Places in the band of a part's weights, its longer side outermost, so that halves are contiguous."""
        at = np.arange(feature, feature + part.features)[:, None] * self.grid.functions
        places = at + np.arange(function, function + part.functions)
        return (places if by_feature else places.T).reshape(-1)
