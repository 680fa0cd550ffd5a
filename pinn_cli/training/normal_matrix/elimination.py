"""The readout weights eliminated front by front: factor, solutions, log determinant and entries of the inverse."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.dissection import Front, FrontTree, Runs

# Added to the diagonal of the scaled matrix (all ones) in every factorisation: a few times the rounding error of its
# largest entry.
ROUNDING_JITTER = 1e-14
# Entries that are placed at once: little enough for the caches, and for no copy of the whole.
ENTRIES_AT_ONCE = 1_000_000


@dataclass(frozen=True, eq=False)
class Elimination:
    """A = R R^T of normal equations [[A, B], [B^T, C]], with the border B of the parameters half solved, R^-1 B.

    R = S P^T L, with the order P of a tree and S the root of A's diagonal: what is half solved is in the tree's order.
    It can be handed back, and added up.

    Attributes:
        tree: Of the fronts.
        scale: (size,), the diagonal of S, in the band's order.
        pivots: Of every front, L among the weights that are eliminated, (k, k); above its diagonal anything.
        below: Of every front, the part of L below those, and of the half solved border: (m + q, k).
        border_gram: B^T A^-1 B, (p, p).
    """

    tree: FrontTree
    scale: np.ndarray
    pivots: list[np.ndarray]
    below: list[np.ndarray]
    border_gram: np.ndarray

    @classmethod
    def of(cls, tree: FrontTree, band: Diagonals, border: csr_matrix, damping: float = 0.0) -> Elimination | None:
        """Of a matrix, its scaled diagonal damped, and its border (size, p); None if it is not positive definite."""
        scale = root_of(band.main)
        if scale is None:
            return None
        unit = 1.0 / scale
        values = _scaled(tree, band, unit)
        values[: tree.size] += damping + ROUNDING_JITTER
        of_border = border.data * np.repeat(unit, np.diff(border.indptr))
        # One piece of memory, which the system takes back whole, and in which the columns are eliminated.
        kept = np.zeros(tree.entries)
        for first in range(0, len(tree.band_target), ENTRIES_AT_ONCE):
            part = slice(first, first + ENTRIES_AT_ONCE)
            kept[tree.band_target[part]] = values[tree.band_source[part]]
        kept[tree.border_target] = of_border[tree.border_source]
        pivots: list[np.ndarray] = []
        below: list[np.ndarray] = []
        gram = np.zeros((border.shape[1],) * 2)
        waiting: dict[int, np.ndarray] = {}
        for number, front in enumerate(tree.fronts):
            k, m, at = front.eliminated, front.remaining, front.at
            pivot = kept[at : at + k * k].reshape((k, k), order="F")
            under = kept[at + k * k : at + front.entries].reshape((m, k), order="F")
            update = np.zeros((m, m), order="F")
            for child in (child for child in front.children if child in waiting):
                _add(pivot, under, update, waiting.pop(child), tree.fronts[child].runs)
            if dpotrf(pivot, lower=1, clean=0, overwrite_a=1)[1]:
                return None
            pivots.append(pivot)
            below.append(under)
            if m:
                dtrsm(1.0, pivot, under, side=1, lower=1, trans_a=1, overwrite_b=1)
                waiting[number] = dsyrk(-1.0, under, beta=1.0, c=update, lower=1, overwrite_c=1)
        for number, update in waiting.items():  # of the roots: parameters alone
            parameters = tree.fronts[number].parameters
            gram[np.ix_(parameters, parameters)] -= update
        return cls(tree, scale, pivots, below, np.tril(gram) + np.tril(gram, -1).T)

    @property
    def size(self) -> int:
        """Of A."""
        return self.tree.size

    @property
    def operations(self) -> float:
        """Additions and multiplications that the factor, the half solved border and its gram took."""
        sizes = np.array([under.shape for under in self.below], dtype=float)
        remaining, k = sizes.T
        return float(np.sum(k * (k + 1) * (2 * k + 1) / 6 + remaining * k**2 + k * remaining**2))

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of A."""
        of_fronts = sum(float(np.log(np.diagonal(pivot)).sum()) for pivot in self.pivots)
        return 2.0 * (of_fronts + float(np.log(self.scale).sum()))

    def half_solved(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R^-1 right and B^T A^-1 right.

        Args:
            right: (size,) or (size, count).

        Returns:
            (size,) and (p,), or (size, count) and (p, count).
        """
        columns = right if right.ndim == 2 else right[:, None]
        half = np.ascontiguousarray((columns / self.scale[:, None])[self.tree.order])
        taken = np.zeros((len(self.border_gram), columns.shape[1]))
        for front, pivot, under in zip(self.tree.fronts, self.pivots, self.below, strict=True):
            block, m = half[front.start : front.stop], len(front.boundary)
            if not block.any():  # functions of the last weights alone begin late
                continue
            dtrsm(1.0, pivot, block.T, side=1, lower=1, trans_a=1, overwrite_b=1)
            moved = under @ block
            half[front.boundary] -= moved[:m]
            taken[front.parameters] += moved[m:]
        return half.reshape(right.shape), taken.reshape(len(taken), *right.shape[1:])

    def solved(self, half: np.ndarray, x: np.ndarray) -> np.ndarray:
        """R^-T (half + R^-1 B x): of half = R^-1 g the solution of A w = g + B x.

        Args:
            half: (size,) or (size, count), half solved.
            x: (p,) or (p, count).
        """
        columns = np.array(half if half.ndim == 2 else half[:, None], order="C")
        by = x.reshape(len(x), columns.shape[1])
        for front, pivot, under in self._backward():
            block, m = columns[front.start : front.stop], len(front.boundary)
            block -= under[:m].T @ columns[front.boundary]
            block += under[m:].T @ by[front.parameters]
            dtrsm(1.0, pivot, block.T, side=1, lower=1, overwrite_b=1)
        out = np.empty_like(columns)
        out[self.tree.order] = columns
        return (out / self.scale[:, None]).reshape(half.shape)

    @property
    def solved_border(self) -> np.ndarray:
        """A^-1 B, (size, p)."""
        p = len(self.border_gram)
        return self.solved(np.zeros((self.size, p)), np.eye(p))

    def inverse(self) -> Diagonals:
        """A^-1, where two weights may be in one row of a residual.

        From the last front to the first, by Takahashi et al. (1973) front by front: with S_ll of the weights that are
        left, S_lo = -S_ll G' and S_oo = (L L')^-1 + G S_ll G', where G = L^-T U' and U is what stands below L. Roots
        of them go from front to front (Bierman 1977): a curvature's variance is a millionth of a millionth of a
        weight's, and is lost in products that are not squares.
        """
        out = np.zeros((len(self.tree.offsets), self.tree.size))
        flat = out.reshape(-1)
        roots: dict[int, np.ndarray] = {}
        for number in reversed(range(len(self.tree.fronts))):
            front, pivot = self.tree.fronts[number], self.pivots[number]
            k, m = front.eliminated, len(front.boundary)
            boundary_root = roots.pop(number) if m else np.zeros((0, 0))
            root = np.zeros((k + m, k + boundary_root.shape[1]))
            root[:k, :k] = np.tril(dtrtri(pivot, lower=1)[0]).T
            if m:
                through = self.below[number][:m].T @ boundary_root
                root[:k, k:], root[k:, k:] = -dtrsm(1.0, pivot, through, lower=1, trans_a=1), boundary_root
            whole = root @ root.T
            column, row = front.cells(self.tree.band_target[front.band])
            flat[self.tree.band_source[front.band]] = whole[row, column]
            for child in (child for child in front.children if len(self.tree.fronts[child].boundary)):
                roots[child] = _taken(root, self.tree.fronts[child])
        for line, offset in zip(out, self.tree.offsets.tolist(), strict=True):
            size = self.tree.size - offset
            line[:size] /= self.scale[:size] * self.scale[offset:]
        return Diagonals(self.tree.offsets, out)

    def _backward(self) -> zip[tuple[Front, np.ndarray, np.ndarray]]:
        return zip(reversed(self.tree.fronts), reversed(self.pivots), reversed(self.below), strict=True)


def root_of(diagonal: np.ndarray) -> np.ndarray | None:
    """The square root of a diagonal (size,); None where a matrix that has it is not positive definite."""
    with np.errstate(invalid="ignore"):
        scale: np.ndarray = np.sqrt(diagonal)
    return scale if np.all(np.isfinite(scale)) and np.all(scale > 0) else None


def triangular_root(root: np.ndarray) -> np.ndarray:
    """(k, k) of the same product R R' as a root (k, r) with more columns; others as they are."""
    if root.shape[1] <= root.shape[0]:
        return root
    upper: np.ndarray = np.asarray(np.linalg.qr(root.T, mode="r"))
    return upper.T


def _scaled(tree: FrontTree, band: Diagonals, unit: np.ndarray) -> np.ndarray:
    """(K size,), the values of a tree's diagonals, rows and columns multiplied by units (size,).

    Raises:
        IndexError: The band has another diagonal.
    """
    size = tree.size
    out = np.zeros((len(tree.offsets), size))
    places = np.searchsorted(tree.offsets, band.offsets)
    if places[-1] >= len(tree.offsets) or not np.array_equal(tree.offsets[places], band.offsets):
        raise IndexError("functions that one row feels stand further apart than the structure's coupling says")
    for place, offset, line in zip(places, band.offsets.tolist(), band.values, strict=True):
        out[place, : size - offset] = line[: size - offset] * unit[: size - offset] * unit[offset:]
    return out.reshape(-1)


def _add(pivot: np.ndarray, under: np.ndarray, update: np.ndarray, more: np.ndarray, runs: Runs) -> None:
    """Add the lower half of what is left of a front to the parts of the front that it belongs to."""
    k = len(pivot)
    for i, (row, above, rows) in enumerate(runs):
        for column, target, columns in runs[: i + 1]:
            part, at = (update, k) if target >= k else (under, 0) if above >= k else (pivot, 0)
            down = above if part is pivot else above - k
            part[down : down + rows, target - at : target - at + columns] += more[
                row : row + rows, column : column + columns
            ]


def _taken(root: np.ndarray, child: Front) -> np.ndarray:
    """(m, r), a root of what is left of another front, without parameters, from that of the front it belongs to."""
    index = np.concatenate([np.arange(target, target + n) for _, target, n in child.runs])[: len(child.boundary)]
    return triangular_root(root[index])


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
        """The difference, with the diagonals of either."""
        offsets = np.union1d(self.offsets, other.offsets)
        values = np.zeros((len(offsets), self.size))
        values[np.searchsorted(offsets, self.offsets)] += self.values
        values[np.searchsorted(offsets, other.offsets)] -= other.values
        return Diagonals(offsets, values)

    def dense(self) -> np.ndarray:
        """(size, size), for few unknowns."""
        lower = np.zeros((self.size, self.size))
        for offset, line in zip(self.offsets.tolist(), self.values, strict=True):
            if offset < self.size:
                lower += np.diag(line[: self.size - offset], -offset)
        return lower + np.tril(lower, -1).T
