"""Normal equations of a linear readout, added up from rows of residuals: blocks over time, parameters as a border.

The weight of (feature f, place j in the order of the n functions) stands at f n + j. In group g of times a row touches
features from g on, B of them. So entries of equal distance, both of features and of functions, are one contiguous line
of the normal matrix. Products of the columns of rows are added to pieces of such lines: no index is looked up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.system.coupling import Coupling
from pinn_cli.training.normal_matrix.elimination import Diagonals
from pinn_cli.training.normal_matrix.separable_rows import WINDOWS_KEPT, SeparableRows, runs


class Touched(NamedTuple):
    """D neighbouring functions that rows touch.

    Attributes:
        first: Place of the first of them in row 0; in every further row it is one further.
        row: The first row that touches them.
        features: (D, B, S, I, w), of w rows from that one on.
    """

    first: int
    row: int
    features: np.ndarray

    @property
    def stop(self) -> int:
        """Behind the last row."""
        return self.row + int(self.features.shape[-1])


@dataclass(frozen=True, eq=False)
class Rows:
    """Linearised residuals at I groups of S times, of several functions in their order or of a single one.

    All are multiplied by the roots of their weights.

    Attributes:
        feature: (I, B) long, the features alive in each group.
        touched: What they are by the readout weights.
        places: (p, rows), of the parameters in every row, -1 where there is none.
        by: (p + 1, S, I, rows), what they are by those; at last the residuals.
    """

    feature: Tensor
    touched: list[Touched]
    places: np.ndarray
    by: np.ndarray


@dataclass(frozen=True, eq=False)
class FullRows:
    """Linearised residuals that touch most functions, R in each of I groups of times.

    All are multiplied by the roots of their weights.

    Attributes:
        feature: (I, B) long, the features alive in each group.
        by_weight: (I, R, B, n), what they are by the readout weights of all functions in their order.
        by: (I, R, p + 1), what they are by the parameters at all places; at last the residuals.
        reached: (n, p) bool, which parameters stand in a row of which function.
    """

    feature: Tensor
    by_weight: np.ndarray
    by: np.ndarray
    reached: np.ndarray


class RowSums:
    """Sums over rows of weighted products.

    Args:
        stride: Features that one group moves on by: the outputs of a function.
        features: B, alive at once.
        count: Of one function in all.
        coupling: The functions' order, and how far those of one row stand apart.
        places: Of parameters.
    """

    def __init__(self, stride: int, features: int, count: int, coupling: Coupling, places: int) -> None:
        self.n, self.features, self.reach, self.rank = coupling.size, features, coupling.reach, coupling.rank
        self.places = places
        self.size, self._stride, self._step = count * self.n, stride, stride * self.n
        # Entries more in front and behind: rows at the structure's ends add zeros there.
        self._length = self.size + 2 * self.n
        self._inside = slice(self.n, self.n + self.size)
        # By distance of functions, from -reach on, and by distance of features: a line of the matrix by its columns.
        self._blocks = np.zeros((2 * self.reach + 1, features, self._length))
        self._used = np.zeros(2 * self.reach + 1, dtype=bool)
        self._gradient = np.zeros((1, self._length))
        # Of every parameter of rows: which place it has by the functions (lines, n), and its lines.
        self._border: dict[tuple[bytes, int, int, int], tuple[np.ndarray, np.ndarray]] = {}
        self._corner, self._slope = np.zeros((places, places)), np.zeros(places)
        self._full: BlockSums | None = None  # of rows that touch most functions
        # What stands beside the band where functions and places meet, and rows of which that is still to be worked out.
        self._beside: dict[tuple[bytes, bytes], tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._waiting: list[SeparableRows] = []

    @property
    def main(self) -> np.ndarray:
        """(size,), the main diagonal."""
        diagonal = self._blocks[self.reach, 0, self._inside]
        return diagonal if self._full is None else diagonal + self._full.line(0)

    @property
    def band(self) -> Diagonals:
        """Of the readout weights against each other, (size, size)."""
        distances = np.arange(-self.reach, self.reach + 1)[self._used | (self._full is not None)].tolist()
        entries = [
            (shift * self.n + distance, shift, distance) for distance in distances for shift in range(self.features)
        ]
        offsets = sorted({0, *(offset for offset, _, _ in entries if offset > 0)})
        place = {offset: line for line, offset in enumerate(offsets)}
        values = np.zeros((len(offsets), self.size))
        values[0] = self.main
        for offset, shift, distance in entries:
            if offset > 0 and self._used[distance + self.reach]:
                values[place[offset]] += self._blocks[distance + self.reach, shift, self._inside]
        if self._full is not None:
            for offset in offsets[1:]:
                values[place[offset]] += self._full.line(offset)
        return Diagonals(np.array(offsets), values)

    @property
    def corner(self) -> np.ndarray:
        """(places, places), of the parameters against each other."""
        self._add_waiting()
        return self._corner

    @property
    def slope(self) -> np.ndarray:
        """(places,), gradient of the parameters."""
        self._add_waiting()
        return self._slope

    @property
    def gradient(self) -> np.ndarray:
        """(size,), of the readout weights."""
        self._add_waiting()
        total: np.ndarray = self._gradient[:, self._inside].sum(axis=0)
        for function, place, values in self._beside.values():
            last = place == self.places
            total.reshape(-1, self.n)[:, function[last]] += values[:, last]
        return total if self._full is None else total + self._full.border[..., -1].reshape(-1)

    def border(self, pick: np.ndarray) -> csr_matrix:
        """(size, p), of the readout weights against the parameters at some places (p,).

        It keeps entries that happen to be zero, so that its pattern stays.
        """
        self._add_waiting()
        column = np.full(self.places + 1, -1)
        column[pick] = np.arange(len(pick))
        first = np.arange(0, self.size, self.n)[:, None]
        entries: list[tuple[np.ndarray, ...]] = [(np.zeros(0), *np.zeros((2, 0), dtype=np.int64))]
        for places, lines in self._border.values():
            for of_function, line in zip(column[places], lines, strict=True):
                at = np.flatnonzero(of_function >= 0)
                values = line[self._inside].reshape(-1, self.n)[:, at]
                entries.append((values, first + at, np.broadcast_to(of_function[at], values.shape)))
        for function, place, values in self._beside.values():
            inside = column[place] >= 0
            to = np.broadcast_to(column[place[inside]], (len(values), int(inside.sum())))
            entries.append((values[:, inside], first + function[inside], to))
        if self._full is not None:
            function, place = np.nonzero(self._full.reached & (column[:-1] >= 0))
            values = self._full.border[:, function, place]
            entries.append((values, first + function, np.broadcast_to(column[place], values.shape)))
        values, row, to = (np.concatenate([x.reshape(-1) for x in part]) for part in zip(*entries, strict=True))
        return csr_matrix((values, (row, to)), shape=(self.size, len(pick)))

    def add(self, rows: Rows) -> None:
        """Add the products of rows with themselves."""
        self._add_corner(rows)
        pairs = [
            (one, other)
            for one, other in product(rows.touched, repeat=2)
            if max(one.row, other.row) < min(one.stop, other.stop)
        ]
        for part, first in runs(rows.feature[:, 0].numpy(), self._stride):
            place = (first + 1) * self.n
            for touched in rows.touched:
                self._add_border(touched, rows, part, place)
            for one, other in pairs:
                self._add_block(one, other, part, place)

    def add_full(self, rows: FullRows) -> None:
        """The same of rows that touch most functions."""
        full = self._of_all
        full.reached |= rows.reached
        by = rows.by.reshape(-1, rows.by.shape[-1])
        products = by[:, :-1].T @ by
        self._corner += products[:, :-1]
        self._slope += products[:, -1]
        if bool((rows.feature[:, 0] == rows.feature[0, 0]).all()):
            together = rows.by_weight.reshape(1, -1, *rows.by_weight.shape[2:])
            full.add(int(rows.feature[0, 0]), self._stride, together, by[None])
            return
        for part, first in runs(rows.feature[:, 0].numpy(), self._stride):
            full.add(first, self._stride, rows.by_weight[part], rows.by[part])

    def add_diagonal(self, weight: float | np.ndarray, unknowns: np.ndarray) -> None:
        """Add weights, (size,) or one of all, of the squares of the readout weights (size,)."""
        self._blocks[self.reach, 0, self._inside] += weight
        self._gradient[0, self._inside] += weight * unknowns

    def add_separable(self, rows: SeparableRows) -> None:
        """Add the products of rows that are features times coefficients with themselves.

        What stands beside the band waits until it is asked for, or until there is more of it than is kept.
        """
        earlier, later = np.nonzero(rows.pairs)
        is_full, distances = 2 * len(earlier) > self.n**2, np.unique(self.rank[later] - self.rank[earlier])
        for over_groups, coupling in rows.terms():
            placed = np.empty_like(coupling)
            placed[:, self.rank[:, None], self.rank] = coupling
            lines = [] if is_full else [(d, np.diagonal(placed, d, 1, 2)) for d in distances.tolist()]
            for first, by_shift in rows.features.products(over_groups):
                for shift, products in enumerate(by_shift):
                    if is_full:
                        block = (products @ placed.reshape(len(placed), -1)).reshape(-1, self.n, self.n)
                        self._of_all.add_products(first, shift, block)
                    for distance, line in lines:
                        self._add_line(products @ line, distance, shift, first)
        self._waiting.append(rows)
        if len(self._waiting) > WINDOWS_KEPT:
            self._add_waiting()

    def _add_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for rows in waiting:
            function, place = rows.meetings
            products = rows.of_parameters()
            self._corner += products[:, :-1]
            self._slope += products[:, -1]
            key = function.tobytes(), place.tobytes()
            if key not in self._beside:
                self._beside[key] = self.rank[function], place, np.zeros((self.size // self.n, len(place)))
            for first, entries in rows.beside():
                self._beside[key][2][first : first + len(entries)] += entries

    @property
    def _of_all(self) -> BlockSums:
        """Of rows that touch most functions, made when the first ones come."""
        if self._full is None:
            self._full = BlockSums(self.features, self.size // self.n, self.n, self.places)
        return self._full

    def _add_corner(self, rows: Rows) -> None:
        by = rows.by.reshape(len(rows.by), -1, rows.by.shape[-1]).transpose(2, 0, 1)
        products = by[:, :-1] @ by.transpose(0, 2, 1)  # (rows, p, p + 1)
        places = rows.places.T
        used = places >= 0
        np.add.at(self._slope, places[used], products[..., -1][used])
        pairs = used[:, :, None] & used[:, None]
        row, column = (np.broadcast_to(x, pairs.shape)[pairs] for x in (places[:, :, None], places[:, None]))
        np.add.at(self._corner, (row, column), products[..., :-1][pairs])

    def _add_block(self, one: Touched, other: Touched, part: slice, place: int) -> None:
        """Products of the features of some functions, later ones, with those of others."""
        row, stop = max(one.row, other.row), min(one.stop, other.stop)
        left, right = (x.features[..., part, row - x.row : stop - x.row] for x in (one, other))
        for (d, b), products in _products(left, right):
            distance = one.first - other.first - d
            # Functions further apart are never in one row.
            near = slice(max(0, -self.reach - distance), max(0, self.reach + 1 - distance))
            if near.start < near.stop and near.start < len(products):
                column = place + b * self.n + other.first + d + row
                self._add_column(products[near], distance + near.start, column)

    def _add_column(self, products: np.ndarray, distance: int, column: int) -> None:
        """Add (D, B - b, I, w), of D functions from a distance on by B - b features from the same one on."""
        assert -self.reach <= distance <= self.reach + 1 - len(products), "functions of one row stand within the band"
        at = distance + self.reach
        self._used[at : at + len(products)] = True
        line, strides = self._length, (self.features * self._length, self._length, self._step, 1)
        cells = self._view(self._blocks, at * self.features * line + column, products.shape, strides)
        cells += products

    def _add_line(self, products: np.ndarray, distance: int, shift: int, first: int) -> None:
        """Add (features, functions): all that have one in this distance, of the features from the first on."""
        assert abs(distance) <= self.reach, "functions of one row stand within the band"
        at = distance + self.reach
        self._used[at] = True
        cells = self._blocks[at, shift, self._inside].reshape(-1, self.n)[first : first + len(products)]
        cells[:, max(0, -distance) : self.n - max(0, distance)] += products

    def _add_border(self, touched: Touched, rows: Rows, part: slice, place: int) -> None:
        """Products of features with what the parameters do, and with the residual."""
        by = rows.by[:, None, ..., part, touched.row : touched.stop]
        # Of several rows the same function is touched by one after the other: each of the D has a line.
        lines, step = (len(touched.features), self._length + 1) if rows.by.shape[-1] > 1 else (1, 1)
        for (number, _), products in _products(touched.features[..., part, :], by):
            array = self._lines(touched, rows.places[number] if number < len(rows.places) else None, lines)
            for b in range(self.features):
                start = place + b * self.n + touched.first + touched.row
                shape = len(products), *products.shape[2:]
                cells = self._view(array, start, shape, (step, self._step, 1))
                cells += products[:, b]

    def _lines(self, touched: Touched, places: np.ndarray | None, lines: int) -> np.ndarray:
        """(lines, length) of one parameter of rows, at its places (rows,); of the gradient where there are none."""
        if places is None:
            if len(self._gradient) < lines:
                more = np.zeros((lines - len(self._gradient), self._length))
                self._gradient = np.concatenate((self._gradient, more))
            return self._gradient
        key = places.tobytes(), touched.first, touched.row, len(touched.features)
        if key not in self._border:
            functions, row = np.full((lines, self.n), -1), np.arange(touched.row, touched.stop)
            for d in range(len(touched.features)):
                at = touched.first + d + row
                inside = (at >= 0) & (at < self.n)
                functions[d % lines, at[inside]] = places[row[inside]]
            self._border[key] = functions, np.zeros((lines, self._length))
        return self._border[key][1]

    @staticmethod
    def _view(array: np.ndarray, start: int, shape: tuple[int, ...], strides: tuple[int, ...]) -> np.ndarray:
        """Some numbers of an array."""
        size = array.itemsize
        return np.ndarray(shape, array.dtype, array, start * size, tuple(size * stride for stride in strides))


def _products(left: np.ndarray, right: np.ndarray) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """Of every column (E, F) of ``right`` the products with ``left``, summed over the times of each group.

    Args:
        left: (D, B, S, I, w).
        right: (E, F, S, I, w).

    Yields:
        The column's place in ``right``, and (D, B - f, I, w), of the features from its own place among F on.
    """
    columns = np.ndindex(right.shape[:2])
    if left.shape[2] == 1:
        for place in columns:
            yield place, left[:, place[1] :, 0] * right[place][0]
        return
    left_rows, right_rows = (x.reshape(-1, *x.shape[2:]).transpose(2, 3, 0, 1) for x in (left, right))
    gram = (np.ascontiguousarray(right_rows) @ np.ascontiguousarray(left_rows).swapaxes(2, 3)).transpose(2, 3, 0, 1)
    for place, products in zip(columns, gram, strict=True):
        yield place, products.reshape(*left.shape[:2], *products.shape[1:])[:, place[1] :]


class BlockSums:
    """Sums over rows of weighted products, of all functions with each other and with the parameters.

    Args:
        features: B, alive at once.
        count: Of one function in all.
        functions: n.
        places: p, of parameters.

    Attributes:
        border: (count, n, p + 1), of the weights against the parameters, at last against the residuals.
        reached: (n, p) bool, which parameters stand in a row of which function.
    """

    def __init__(self, features: int, count: int, functions: int, places: int) -> None:
        # By feature and function, those that follow: of the feature itself first, then of the later ones.
        self._later = np.zeros((count, functions, (features + 1) * functions))
        self.border = np.zeros((count, functions, places + 1))
        self.reached = np.zeros((functions, places), dtype=bool)

    def add(self, first: int, stride: int, rows: np.ndarray, by: np.ndarray) -> None:
        """Add the products of rows with themselves.

        Args:
            first: Feature of the first group; each group begins ``stride`` further on.
            stride: See above.
            rows: (I, R, B, n), of I groups, R each, by the weights.
            by: (I, R, p + 1), by the parameters, and the residuals.
        """
        if len(rows) < rows.shape[2]:
            for group, (group_rows, group_by) in enumerate(zip(rows, by, strict=True)):
                self._add_group(first + group * stride, group_rows, group_by)
            return
        groups, per_group, features, functions = rows.shape
        last = (groups - 1) * stride + 1
        count = last - 1 + features
        below, border = (np.zeros((count, features, per_group, width)) for width in (functions, by.shape[2]))
        for b in range(features):
            below[b : b + last : stride, b], border[b : b + last : stride, b] = rows[:, :, b], by
        below, border = (x.reshape(count, features * per_group, -1) for x in (below, border))
        across = below.swapaxes(1, 2)
        self.border[first : first + count] += across @ border
        for shift in range(features):
            # Rows under both: of the earlier feature all but the last groups, of the later one all but the first.
            shared = (features - shift) * per_group
            products = across[: count - shift, :, :shared] @ below[shift:, shift * per_group :]
            self._block(shift)[first : first + count - shift] += products

    def add_products(self, first: int, shift: int, products: np.ndarray) -> None:
        """Add (F, n, n), of the functions of the first and following features with those of later ones."""
        self._block(shift)[first : first + len(products)] += products

    def _add_group(self, first: int, rows: np.ndarray, by: np.ndarray) -> None:
        """Of one group (R, B, n) by itself."""
        features, functions = rows.shape[1:]
        flat = rows.reshape(len(rows), -1)
        self.border[first : first + features] += (flat.T @ by).reshape(features, functions, -1)
        products = (flat.T @ flat).reshape(features, functions, features, functions)
        for shift in range(features):
            earlier = np.arange(features - shift)
            self._block(shift)[first : first + features - shift] += products[earlier, :, earlier + shift]

    def _block(self, shift: int) -> np.ndarray:
        """(count, n, n), of every feature's functions with those of a later one."""
        functions = self._later.shape[1]
        return self._later[:, :, shift * functions : (shift + 1) * functions]

    def line(self, offset: int) -> np.ndarray:
        """(count n,), a diagonal of the lower half by its columns: so far below the main one."""
        by_feature, by_function, entry = self._later.strides
        start = self._later[:, :, offset:]
        shape, strides = self._later.shape[:2], (by_feature, by_function + entry)
        return np.lib.stride_tricks.as_strided(start, shape, strides, writeable=False).reshape(-1)
