"""Many right-hand sides of a triangular band at once.

LAPACK's ``dtbtrs`` takes them one by one, which reads the factor from memory for each. Here blocks of rows are solved
for all of them together, by products with all rows that the band reaches and by triangular solves.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg.blas import dgemm, dtrsm
from scipy.linalg.lapack import dtbtrs

# Rows of a block; half-width, and right-hand sides, from which on blocks are worth their copies; and how many
# right-hand sides are worth them whatever the half-width.
BLOCK, WIDE, ENOUGH, MANY = 96, 64, 6, 100


def forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """X of L X = right.

    Args:
        factor: Lower band of L, (half_width + 1, size), in Fortran's order; entry [i - j, j] is L[i, j].
        right: (size,) or (size, count).

    Returns:
        As large as ``right``.
    """
    if not _is_worth_blocks(factor, right):
        return _one_by_one(factor, right, "N")
    x, size, half_width = np.array(right, order="C"), factor.shape[1], len(factor) - 1
    for start in range(0, size, BLOCK):
        stop, first = min(start + BLOCK, size), max(start - half_width, 0)
        # Transposed, rows of C's order are columns of Fortran's: BLAS works on them where they are.
        here = x[start:stop].T
        if start > first:
            before = _before(factor, start, stop, first)
            dgemm(-1.0, x[first:start].T, before.T, beta=1.0, c=here, overwrite_c=1)
        dtrsm(1.0, diagonal_block(factor, start, stop), here, side=1, lower=1, trans_a=1, overwrite_b=1)
    return x


def backward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """X of L' X = right; see :func:`forward`."""
    if not _is_worth_blocks(factor, right):
        return _one_by_one(factor, right, "T")
    x, size = np.array(right, order="C"), factor.shape[1]
    for start in reversed(range(0, size, BLOCK)):
        stop = min(start + BLOCK, size)
        end, here = min(stop + len(factor) - 1, size), x[start:stop].T
        if end > stop:
            dgemm(-1.0, x[stop:end].T, rows_below(factor, start, stop, end), beta=1.0, c=here, overwrite_c=1)
        dtrsm(1.0, diagonal_block(factor, start, stop), here, side=1, lower=1, overwrite_b=1)
    return x


def _is_worth_blocks(factor: np.ndarray, right: np.ndarray) -> bool:
    return right.ndim == 2 and right.shape[1] >= (ENOUGH if len(factor) > WIDE else MANY)


def _one_by_one(factor: np.ndarray, right: np.ndarray, trans: str) -> np.ndarray:
    if right.size == 0:
        return right
    solved: np.ndarray = dtbtrs(factor, right, uplo="L", trans=trans)[0]
    return solved


def _view(factor: np.ndarray, row: int, column: int, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) of L from an entry on. A band by columns is a dense matrix whose columns overlap by one.

    What lies outside the band is some other entry.
    """
    width, size = factor.shape[0], factor.itemsize
    flat = factor.ravel(order="K")
    return as_strided(flat[column * width + row - column :], (rows, columns), (size, (width - 1) * size))


def diagonal_block(factor: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Of L, rows and columns start to stop; above the diagonal anything."""
    out = np.array(_view(factor, start, start, stop - start, stop - start), order="F")
    return _cleared(out, len(factor) - 1)


def _before(factor: np.ndarray, start: int, stop: int, first: int) -> np.ndarray:
    """Of L, rows start to stop and the columns before them, from ``first`` on."""
    out = np.array(_view(factor, start, first, stop - start, start - first), order="C")
    reach = len(factor) - 1 - (start - first)  # how much further than to the first column the band reaches
    return _cleared(out, reach)


def rows_below(factor: np.ndarray, start: int, stop: int, end: int) -> np.ndarray:
    """Of L, columns start to stop and the rows below them, down to ``end``."""
    out = np.array(_view(factor, stop, start, end - stop, stop - start), order="F")
    reach = len(factor) - 1 - (stop - start)  # rows that the first column reaches
    return _cleared(out, reach)


def _cleared(block: np.ndarray, reach: int) -> np.ndarray:
    """A copied block of L with zeros where it is outside the band: below its diagonal number -reach."""
    if reach < block.shape[0] - 1:
        rows, columns = np.ogrid[: block.shape[0], : block.shape[1]]
        block[rows - columns > reach] = 0.0
    return block
