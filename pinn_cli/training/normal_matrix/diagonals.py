"""Symmetric bands of which few diagonals hold anything."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


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
    def half_width(self) -> int:
        """Of the band that holds all diagonals."""
        return int(self.offsets[-1])

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
        if offset.size and int(offset.max()) > self.half_width:
            raise IndexError(f"an entry {int(offset.max())} off the diagonal of a band of {self.half_width}")
        line: np.ndarray = self._line[offset]
        if offset.size and int(line.min()) < 0:
            raise IndexError("an entry on a diagonal that is not kept")
        return line

    @cached_property
    def _line(self) -> np.ndarray:
        line = np.full(self.half_width + 1, -1)
        line[self.offsets] = np.arange(len(self.offsets))
        return line

    def trace_of_product(self, other: Diagonals) -> float:
        """The trace of its product with another, which keeps no diagonal that this one does not."""
        lines = self.values[self.lines(other.offsets)]
        by_line = np.einsum("ij,ij->i", lines, other.values)
        return float(2.0 * by_line.sum() - by_line[0])

    def __sub__(self, other: Diagonals) -> Diagonals:
        """The difference of two that keep the same diagonals."""
        assert np.array_equal(self.offsets, other.offsets), "two matrices of the same rows"
        return Diagonals(self.offsets, self.values - other.values)

    def dense(self) -> np.ndarray:
        """(size, size), for few unknowns."""
        lower = np.zeros((self.size, self.size))
        for offset, line in zip(self.offsets.tolist(), self.values, strict=True):
            if offset < self.size:
                lower += np.diag(line[: self.size - offset], -offset)
        return lower + np.tril(lower, -1).T
