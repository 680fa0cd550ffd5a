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
from functools import lru_cache
from typing import NamedTuple

import numpy as np

# Of a dense front with k rows that are eliminated and m that are left: cost of an operation in its Cholesky factor
# (k^3 / 3), in the triangular solutions (k^2 m) and in the products (k m^2); of an entry that is filled and added; of
# the front itself. Measured in products.
CHOLESKY, SOLUTION, ENTRY, FRONT = 2.5, 2.5, 60.0, 4e6
# Weights of a slab, and of a part that is not cut any further, at most.
LARGEST = 400


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
        how: ``leaf``, ``slabs`` or ``halves``.
        axis: Along which it is cut, ``features`` or ``functions``.
        length: Of a slab along it.
    """

    cost: float
    entries: float
    how: str
    axis: str
    length: int


def fronts(count: int, eliminated: float, left: float) -> tuple[float, float]:
    """Cost and entries of the factor, of so many fronts with so many rows that are eliminated and that are left."""
    k, m = eliminated, left
    cost = CHOLESKY * k**3 / 3 + SOLUTION * k**2 * m + k * m**2 + ENTRY * (k + m) ** 2 + FRONT
    return count * cost, count * k * (k + m)


class Dissection:
    """The cheapest order of elimination of a grid.

    Args:
        grid: Of the weights.
        largest: Weights of a slab, and of a part that is not cut any further, at most.
    """

    def __init__(self, grid: Grid, largest: int = LARGEST) -> None:
        self.grid, self.largest = grid, largest
        self._best = lru_cache(None)(self._cheapest)
        self._whole = Part(grid.features, grid.functions, False, False, False, False)

    @property
    def best(self) -> Choice:
        """Of all weights."""
        return self._best(self._whole)

    def tree(self) -> Separated:
        """The order."""
        return self._tree(self._whole, 0, 0)

    def _thick(self, axis: str) -> int:
        """What a cut across an axis takes to separate its sides."""
        return self.grid.span if axis == "features" else self.grid.reach

    def _left(self, part: Part, features: float, functions: float) -> float:
        """Weights and parameters around a part, of which so many features and functions are eliminated."""
        grid = self.grid
        beside, along = grid.reach * (part.below + part.above), grid.span * (part.before + part.after)
        parameters = grid.parameters * min(1.0, (functions + 2 * grid.reach) / grid.functions)
        return along * (functions + beside) + features * beside + parameters

    def _cheapest(self, part: Part) -> Choice:
        size, around = part.features * part.functions, self._left(part, part.features, part.functions)
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
        every, length = getattr(part, axis), 1
        across = part.features * part.functions // every
        open_end = part._replace(**{"after" if axis == "features" else "above": True})
        # Along the features there is always one; all features of a function are one where they are few.
        most = max(self.largest, across) if axis == "features" else self.largest
        while length <= every and length * across <= most:
            # Half of the slabs, on average, have been eliminated; the next ones are left as well.
            done = {axis: min(every, every / 2 + self._thick(axis))}
            left = self._left(open_end, **{"features": part.features, "functions": part.functions} | done)
            yield Choice(*fronts(math.ceil(every / length), length * across, left), "slabs", axis, length)
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
