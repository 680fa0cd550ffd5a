"""The readout weights eliminated one after the other, in their band: LAPACK's banded Cholesky factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtbsv
from scipy.linalg.lapack import dpbtrf
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.dissection import InBand
from pinn_cli.training.normal_matrix.elimination import (
    Diagonals,
    Elimination,
    root_of,
    root_of_inverse,
    triangular_root,
    unit_diagonals,
)

# Weights at least of whose inverse the entries are worked out at once.
LEAST_PART = 64


@dataclass(frozen=True, eq=False)
class BandElimination(Elimination):
    """One weight after the other.

    Attributes:
        order: What stands in the band.
        scale: See :class:`Elimination`.
        lower: (size, half width + 1), the columns of L from the diagonal down.
        border: (p, size), the half solved border, transposed.
        border_gram: See :class:`Elimination`.
    """

    order: InBand
    scale: np.ndarray
    lower: np.ndarray
    border: np.ndarray
    border_gram: np.ndarray

    @classmethod
    def of(cls, order: InBand, band: Diagonals, border: csr_matrix, damping: float = 0.0) -> BandElimination | None:
        """Of a matrix, its scaled diagonal damped, and its border (size, p); None if it is not positive definite."""
        scale = root_of(band.main)
        if scale is None:
            return None
        unit = 1.0 / scale
        columns = np.zeros((len(scale), order.half_width + 1))
        columns[:, order.offsets] = unit_diagonals(band, order.offsets, unit, damping).T
        lower, refused = dpbtrf(columns.T, lower=1, overwrite_ab=1)
        if refused:
            return None
        half = border.multiply(unit[:, None]).T.toarray()
        _forward(lower, half)
        return cls(order, scale, lower.T, half, half @ half.T)

    @property
    def operations(self) -> float:
        """See :attr:`Elimination.operations`."""
        return float(self.size * (self.order.half_width + 1 + len(self.border)) ** 2)

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
            dtbsv(self.order.half_width, self.lower.T, line, lower=1, trans=1, overwrite_x=1)
        return (lines / self.scale).T.reshape(half.shape)

    def inverse(self) -> Diagonals:
        """See :meth:`Elimination.inverse`."""
        size, width, part = self.size, self.order.half_width, max(LEAST_PART, self.order.half_width)
        out, root = np.zeros((len(self.order.offsets), size)), np.zeros((0, 0))
        for start in reversed(range(0, size, part)):
            stop, end = min(start + part, size), min(start + part + width, size)
            columns = np.zeros((end - start, stop - start), order="F")
            for column in range(stop - start):
                height = min(width + 1, end - start - column)
                columns[column : column + height, column] = self.lower[start + column, :height]
            root = root_of_inverse(columns[: stop - start], columns[stop - start :], root)
            whole = root @ root.T
            for line, offset in zip(out, self.order.offsets.tolist(), strict=True):
                entries = np.diagonal(whole, -offset)[: stop - start]
                line[start : start + len(entries)] = entries
            root = triangular_root(root[:width])
        return Diagonals(self.order.offsets, out).over(self.scale)


def _forward(lower: np.ndarray, lines: np.ndarray) -> None:
    """L^-1 of every line (size,), in place; functions of the last weights alone begin late."""
    for line in lines:
        first = int(np.argmax(line != 0.0))
        dtbsv(len(lower) - 1, lower[:, first:], line[first:], lower=1, overwrite_x=1)
