"""Cholesky factors of symmetric positive definite bands, scaled to a diagonal of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided, sliding_window_view
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpbtrf, dtrtri

from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.triangular_bands import backward, diagonal_block, forward, rows_below

# Added to the diagonal of the scaled matrix (all ones) in every factorisation: a few times the rounding error of its
# largest entry.
ROUNDING_JITTER = 1e-14
# Columns that are scaled at once: few enough for the caches.
CHUNK = 256
# Rows of a block of the inverse, at least: few enough blocks, and little work in each that the band does not ask for.
BLOCK = 32


@dataclass(frozen=True, eq=False)
class BandFactor:
    """A = S L L' S, with S the square root of A's diagonal.

    Attributes:
        band: Lower band of L, (half_width + 1, size), in Fortran's order; entry [i - j, j] is L[i, j].
        scale: (size,), the diagonal of S.
    """

    band: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, matrix: Diagonals, damping: float = 0.0) -> BandFactor | None:
        """The factor of a band; None if it is not positive definite.

        Args:
            matrix: A.
            damping: Added to the scaled diagonal.
        """
        scale = root_of(matrix.main)
        if scale is None:
            return None
        scaled = _scaled(matrix, 1.0 / scale)
        scaled[0] += damping + ROUNDING_JITTER
        factor, failed = dpbtrf(scaled, lower=1, overwrite_ab=1)
        return None if failed else cls(factor, scale)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of A."""
        return 2.0 * float(np.log(self.band[0]).sum() + np.log(self.scale).sum())

    def forward(self, right: np.ndarray) -> np.ndarray:
        """(S L)^-1 right, (size,) or (size, count)."""
        return forward(self.band, right / _by_row(self.scale, right))

    def backward(self, right: np.ndarray) -> np.ndarray:
        """(L' S)^-1 right, (size,) or (size, count)."""
        return backward(self.band, right) / _by_row(self.scale, right)

    def inverse_band(self) -> np.ndarray:
        """The entries of A^-1 inside the band of A, (half_width + 1, size), laid out like the band itself.

        Block form of the recursion of Takahashi et al. (1973): with blocks as wide as the band or wider, the factor is
        block bidiagonal, and the inverse's diagonal and first sub-diagonal blocks follow from the last to the first.
        What goes from block to block is a root R of the diagonal one, R R' (Bierman 1977): a curvature's variance is a
        millionth of a millionth of a weight's, and is lost in products that are not squares.
        """
        rows, size = self.band.shape
        block = max(rows, BLOCK)
        out, tall = np.zeros((rows, size)), np.zeros((block + rows - 1, block), order="F")
        root = np.zeros((0, 0))
        for start in range((size - 1) // block * block, -1, -block):
            stop, end = min(start + block, size), min(start + block + rows - 1, size)
            count, own = stop - start, diagonal_block(self.band, start, stop)
            blocks = [np.tril(dtrtri(own, lower=1)[0]).T]
            tall[count:] = 0.0
            if end > stop:
                # R of this block is [L^-T, -L^-T U' R], with U the rows of L below and R of the block there.
                before = root[: end - stop]
                through = dtrsm(-1.0, own, rows_below(self.band, start, stop, end).T @ before, lower=1, trans_a=1)
                tall[count : count + end - stop, :count] = before @ through.T
                blocks.append(through)
            root = triangular_root(np.hstack(blocks))
            tall[:count, :count] = root @ root.T
            # Entry [k, j] is the one in column j, k rows below the diagonal.
            out[:, start:stop] = as_strided(tall, (rows, count), (tall.itemsize, tall.strides[1] + tall.itemsize))
        for k in range(len(out)):
            out[k, : size - k] /= self.scale[: size - k] * self.scale[k:]
        return out


def triangular_root(root: np.ndarray) -> np.ndarray:
    """(k, k) of the same product R R' as a root (k, r) with more columns; others as they are."""
    if root.shape[1] <= root.shape[0]:
        return root
    upper: np.ndarray = np.asarray(np.linalg.qr(root.T, mode="r"))
    return upper.T


def root_of(diagonal: np.ndarray) -> np.ndarray | None:
    """The square root of a diagonal (size,); None where a matrix that has it is not positive definite."""
    with np.errstate(invalid="ignore"):
        scale: np.ndarray = np.sqrt(diagonal)
    return scale if np.all(np.isfinite(scale)) and np.all(scale > 0) else None


def _scaled(matrix: Diagonals, unit: np.ndarray) -> np.ndarray:
    """Lower band in Fortran's order, rows and columns multiplied by units (size,)."""
    rows, size = matrix.half_width + 1, matrix.size
    kept = slice(None) if len(matrix.offsets) == rows else matrix.offsets
    out = np.zeros((rows, size), order="F")
    of_rows = sliding_window_view(np.concatenate((unit, np.zeros(rows - 1))), rows).T  # [i - j, j]: of row i
    for start in range(0, size, CHUNK):
        part = slice(start, min(start + CHUNK, size))
        out[kept, part] = matrix.values[:, part] * unit[part] * of_rows[kept, part]
    return out


def _by_row(scale: np.ndarray, right: np.ndarray) -> np.ndarray:
    return scale if right.ndim == 1 else scale[:, None]
