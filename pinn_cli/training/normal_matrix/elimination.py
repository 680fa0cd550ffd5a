"""The readout weights eliminated from normal equations: what every way of doing it gives, and that along their band.

In the band one weight is eliminated after the other, by LAPACK's banded Cholesky factor.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.blas import dtbsv, dtrsm
from scipy.linalg.lapack import dpbtrf, dtrtri
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.dissection import Grid

# Added to the diagonal of the scaled matrix (all ones) in every factorisation: a few times the rounding error of its
# largest entry.
ROUNDING_JITTER = 1e-14
# Weights at least of whose inverse the entries are worked out at once.
LEAST_PART = 64


class Order(ABC):
    """In which the readout weights are eliminated.

    Attributes:
        grid: Of the weights.
    """

    grid: Grid

    @property
    @abstractmethod
    def alone(self) -> Order:
        """The same without a border."""

    @abstractmethod
    def suits(self, border: csr_matrix) -> bool:
        """Whether another border may stand in the place of its own."""

    def eliminated(self, band: Diagonals, border: csr_matrix, damping: float = 0.0) -> Elimination | None:
        """Of a matrix, its scaled diagonal damped, and its border (size, p); None if it is not positive definite.

        Raises:
            IndexError: The matrix has a diagonal that the grid has not.
        """
        with np.errstate(invalid="ignore"):
            scale: np.ndarray = np.sqrt(band.main)
        if not (np.all(np.isfinite(scale)) and np.all(scale > 0)):
            return None
        unit, offsets, size = 1.0 / scale, self.grid.offsets, len(scale)
        values = np.zeros((len(offsets), size))
        places = np.searchsorted(offsets, band.offsets)
        if places[-1] >= len(offsets) or not np.array_equal(offsets[places], band.offsets):
            raise IndexError("functions that one row feels stand further apart than the structure's coupling says")
        for place, offset, line in zip(places, band.offsets.tolist(), band.values, strict=True):
            if offset < size:
                values[place, : size - offset] = line[: size - offset] * unit[: size - offset] * unit[offset:]
        values[0] += damping + ROUNDING_JITTER
        scaled = border.data * np.repeat(unit, np.diff(border.indptr)), border.indices, border.indptr
        return self._factored(scale, values, csr_matrix(scaled, border.shape))

    @abstractmethod
    def _factored(self, scale: np.ndarray, values: np.ndarray, border: csr_matrix) -> Elimination | None:
        """The same of the matrix by its diagonals (K, size), and of its border, both over the root of its diagonal."""


class Elimination(ABC):
    """A = R R^T of normal equations [[A, B], [B^T, C]], with the border B of the parameters half solved, R^-1 B.

    R = S P^T L, with an order P of elimination and S the root of A's diagonal: what is half solved is in that order. It
    can be handed back, and added up.

    Attributes:
        scale: (size,), the diagonal of S, in the band's order.
        border_gram: B^T A^-1 B, (p, p).
    """

    scale: np.ndarray
    border_gram: np.ndarray

    @property
    def size(self) -> int:
        """Of A."""
        return len(self.scale)

    @property
    @abstractmethod
    def operations(self) -> float:
        """Additions and multiplications that the factor, the half solved border and its gram took."""

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of A."""
        return 2.0 * (self._log_pivots + float(np.log(self.scale).sum()))

    @property
    @abstractmethod
    def _log_pivots(self) -> float:
        """Sum of the logarithms of the diagonal of L."""

    @abstractmethod
    def half_solved(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R^-1 right and B^T A^-1 right: of (size,) or (size, count), and (p,) or (p, count)."""

    @abstractmethod
    def solved(self, half: np.ndarray, x: np.ndarray) -> np.ndarray:
        """R^-T (half + R^-1 B x): of half = R^-1 g the solution of A w = g + B x, of one or of ``count`` columns."""

    @property
    def solved_border(self) -> np.ndarray:
        """A^-1 B, (size, p)."""
        p = len(self.border_gram)
        return self.solved(np.zeros((self.size, p)), np.eye(p))

    @abstractmethod
    def inverse(self) -> Diagonals:
        """A^-1, where two weights may be in one row of a residual.

        From the last weights to the first, by Takahashi et al. (1973) part by part: with S_ll of the weights that are
        left, S_lo = -S_ll G' and S_oo = (L L')^-1 + G S_ll G', where G = L^-T U' and U is what stands below L. Roots
        of them go from part to part (Bierman 1977): a curvature's variance is a millionth of a millionth of a
        weight's, and is lost in products that are not squares.
        """


def root_of_inverse(pivot: np.ndarray, below: np.ndarray, root: np.ndarray) -> np.ndarray:
    """A root of A^-1 among the k weights of a part and the m that are left, from that of the latter.

    Args:
        pivot: (k, k), L; above its diagonal anything.
        below: (m, k), what stands below it.
        root: (m, r).

    Returns:
        (k + m, k + r).
    """
    (m, k), r = below.shape, root.shape[1]
    out = np.zeros((k + m, k + r))
    out[:k, :k] = np.tril(dtrtri(pivot, lower=1)[0]).T
    if m:
        out[:k, k:] = -dtrsm(1.0, pivot, below.T @ root, lower=1, trans_a=1)
        out[k:, k:] = root
    return out


def triangular_root(root: np.ndarray) -> np.ndarray:
    """(k, k) of the same product R R' as a root (k, r) with more columns; others as they are."""
    if root.shape[1] <= root.shape[0]:
        return root
    upper: np.ndarray = np.asarray(np.linalg.qr(root.T, mode="r"))
    return upper.T


@dataclass(frozen=True, eq=False)
class InBand(Order):
    """All weights one after the other, as they stand in the band.

    Attributes:
        grid: Of the weights.
        parameters: In the border.
    """

    grid: Grid
    parameters: int

    @property
    def alone(self) -> InBand:
        """See :attr:`Order.alone`."""
        return InBand(self.grid, 0)

    def suits(self, border: csr_matrix) -> bool:
        """See :meth:`Order.suits`."""
        return bool(border.shape[1] == self.parameters)

    def _factored(self, scale: np.ndarray, values: np.ndarray, border: csr_matrix) -> BandElimination | None:
        offsets = self.grid.offsets
        columns = np.zeros((len(scale), offsets[-1] + 1))
        columns[:, offsets] = values.T
        lower, refused = dpbtrf(columns.T, lower=1, overwrite_ab=1)
        if refused:
            return None
        half = border.T.toarray(order="C")
        _forward(lower, half)
        return BandElimination(offsets, scale, lower.T, half, half @ half.T)


@dataclass(frozen=True, eq=False)
class BandElimination(Elimination):
    """One weight after the other.

    Attributes:
        offsets: (K,), ascending, the diagonals that hold something.
        scale: See :class:`Elimination`.
        lower: (size, half width + 1), the columns of L from the diagonal down.
        border: (p, size), the half solved border, transposed.
        border_gram: See :class:`Elimination`.
    """

    offsets: np.ndarray
    scale: np.ndarray
    lower: np.ndarray
    border: np.ndarray
    border_gram: np.ndarray

    @property
    def _width(self) -> int:
        return self.lower.shape[1] - 1

    @property
    def operations(self) -> float:
        """See :attr:`Elimination.operations`."""
        return float(self.size * (self._width + 1 + len(self.border)) ** 2)

    @property
    def _log_pivots(self) -> float:
        return float(np.log(self.lower[:, 0]).sum())

    def half_solved(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Elimination.half_solved`."""
        lines = np.ascontiguousarray(np.atleast_2d(right.T) / self.scale)
        _forward(self.lower.T, lines)
        return lines.T.reshape(right.shape), (self.border @ lines.T).reshape(len(self.border), *right.shape[1:])

    def solved(self, half: np.ndarray, x: np.ndarray) -> np.ndarray:
        """See :meth:`Elimination.solved`."""
        lines = np.array(np.atleast_2d(half.T), order="C")
        lines += x.reshape(len(x), len(lines)).T @ self.border
        for line in lines:
            dtbsv(self._width, self.lower.T, line, lower=1, trans=1, overwrite_x=1)
        return (lines / self.scale).T.reshape(half.shape)

    def inverse(self) -> Diagonals:
        """See :meth:`Elimination.inverse`."""
        size, width, part = self.size, self._width, max(LEAST_PART, self._width)
        out, root = np.zeros((len(self.offsets), size)), np.zeros((0, 0))
        for start in reversed(range(0, size, part)):
            stop, end = min(start + part, size), min(start + part + width, size)
            columns = np.zeros((end - start, stop - start), order="F")
            for column in range(stop - start):
                height = min(width + 1, end - start - column)
                columns[column : column + height, column] = self.lower[start + column, :height]
            root = root_of_inverse(columns[: stop - start], columns[stop - start :], root)
            whole = root @ root.T
            for line, offset in zip(out, self.offsets.tolist(), strict=True):
                entries = np.diagonal(whole, -offset)[: stop - start]
                line[start : start + len(entries)] = entries
            root = triangular_root(root[:width])
        return Diagonals(self.offsets, out).over(self.scale)


def _forward(lower: np.ndarray, lines: np.ndarray) -> None:
    """L^-1 of every line (size,), in place; functions of the last weights alone begin late."""
    for line in lines:
        first = int(np.argmax(line != 0.0))
        dtbsv(len(lower) - 1, lower[:, first:], line[first:], lower=1, overwrite_x=1)


@dataclass(frozen=True, eq=False)
class Diagonals:
    """A symmetric matrix by the diagonals of its lower half that may hold something.

    With the weights of n functions ordered by feature, a spline's normal matrix holds 23 of 5 n diagonals for a chain.

    Attributes:
        offsets: (K,), ascending from 0: which diagonals, 0 the main one.
        values: (K, size); [i, j] is the entry in column j and row j + offsets[i], 0 where there is no such row.
    """

    offsets: np.ndarray
    values: np.ndarray

    @property
    def size(self) -> int:
        """Rows of the matrix."""
        return int(self.values.shape[1])

    @property
    def main(self) -> np.ndarray:
        """(size,), the main diagonal."""
        line: np.ndarray = self.values[0]
        return line

    def at(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Entries of the matrix.

        Raises:
            IndexError: One is on a diagonal that is not kept.
        """
        line, first = self.lines(np.abs(row - column)), np.minimum(row, column)
        entries: np.ndarray = self.values[line, first]
        return entries

    def lines(self, offset: np.ndarray) -> np.ndarray:
        """Which of the lines of :attr:`values` a diagonal is.

        Raises:
            IndexError: It is not kept.
        """
        if offset.size and int(offset.max()) >= len(self._line):
            raise IndexError(f"an entry {int(offset.max())} off the diagonal of a band of {len(self._line) - 1}")
        line: np.ndarray = self._line[offset]
        if offset.size and int(line.min()) < 0:
            raise IndexError("an entry on a diagonal that is not kept")
        return line

    @cached_property
    def _line(self) -> np.ndarray:
        line = np.full(int(self.offsets[-1]) + 1, -1)
        line[self.offsets] = np.arange(len(self.offsets))
        return line

    def over(self, scale: np.ndarray) -> Diagonals:
        """Rows and columns divided by (size,), in place."""
        for line, offset in zip(self.values, self.offsets.tolist(), strict=True):
            if offset < self.size:
                line[: self.size - offset] /= scale[: self.size - offset] * scale[offset:]
        return self

    def __add__(self, other: Diagonals) -> Diagonals:
        """The sum, with the diagonals of either."""
        offsets = np.union1d(self.offsets, other.offsets)
        values = np.zeros((len(offsets), self.size))
        for one in (self, other):
            values[np.searchsorted(offsets, one.offsets)] += one.values
        return Diagonals(offsets, values)

    def dense(self) -> np.ndarray:
        """(size, size), for few unknowns."""
        lower = np.zeros((self.size, self.size))
        for offset, line in zip(self.offsets.tolist(), self.values, strict=True):
            if offset < self.size:
                lower += np.diag(line[: self.size - offset], -offset)
        return lower + np.tril(lower, -1).T
