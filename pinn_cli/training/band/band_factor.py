"""Cholesky factors of symmetric positive definite bands, scaled to a diagonal of one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpbtrf

from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.triangular_bands import backward, forward

# Added to the diagonal of the scaled matrix (all ones) in every factorisation: a few times the rounding error of its
# largest entry.
ROUNDING_JITTER = 1e-14
# Columns that are scaled at once: few enough for the caches.
CHUNK = 256


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

        Block form of the recursion of Takahashi et al. (1973): with blocks as wide as the band, the factor is block
        bidiagonal, and the inverse's diagonal and first sub-diagonal blocks follow from the last to the first.
        """
        width, size = max(len(self.band) - 1, 1), self.band.shape[1]
        out = np.zeros_like(self.band)
        below = np.zeros((0, 0))
        for start in range((size - 1) // width * width, -1, -width):
            stop, end = min(start + width, size), min(start + 2 * width, size)
            inverse = solve_triangular(
                _dense_block(self.band, start, stop, start, stop), np.eye(stop - start), lower=True
            )
            gain = _dense_block(self.band, stop, end, start, stop) @ inverse
            coupling = -below @ gain
            diagonal = inverse.T @ inverse - gain.T @ coupling
            _store_columns(out, np.vstack((diagonal, coupling)), start)
            below = diagonal
        for k in range(len(out)):
            out[k, : size - k] /= self.scale[: size - k] * self.scale[k:]
        return out


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


def _dense_block(band: np.ndarray, row_start: int, row_stop: int, column_start: int, column_stop: int) -> np.ndarray:
    """Rows and columns of the lower triangular matrix whose lower band is given, as a dense array."""
    offset = np.arange(row_start, row_stop)[:, None] - np.arange(column_start, column_stop)
    inside = (offset >= 0) & (offset < len(band))
    columns = np.broadcast_to(np.arange(column_start, column_stop), offset.shape)
    return np.where(inside, band[np.where(inside, offset, 0), columns], 0.0)


def _store_columns(band: np.ndarray, block: np.ndarray, start: int) -> None:
    """Write the lower-band part of dense columns, whose first row and column are ``start``, into the band."""
    rows, columns = block.shape
    for k in range(min(len(band), rows)):
        length = min(columns, rows - k)
        band[k, start : start + length] = block[np.arange(length) + k, np.arange(length)]
