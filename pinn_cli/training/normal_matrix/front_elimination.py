"""The readout weights eliminated front by front (Duff and Reid 1983)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.dissection import Front, FrontTree, Runs
from pinn_cli.training.normal_matrix.elimination import (
    Diagonals,
    Elimination,
    root_of,
    root_of_inverse,
    triangular_root,
    unit_diagonals,
)

# Entries that are placed at once: little enough for the caches, and for no copy of the whole.
ENTRIES_AT_ONCE = 1_000_000


@dataclass(frozen=True, eq=False)
class FrontElimination(Elimination):
    """Front by front.

    Attributes:
        tree: Of the fronts.
        scale: See :class:`Elimination`.
        pivots: Of every front, L among the weights that are eliminated, (k, k); above its diagonal anything.
        below: Of every front, the part of L below those, and of the half solved border: (m + q, k).
        border_gram: See :class:`Elimination`.
    """

    tree: FrontTree
    scale: np.ndarray
    pivots: list[np.ndarray]
    below: list[np.ndarray]
    border_gram: np.ndarray

    @classmethod
    def of(cls, tree: FrontTree, band: Diagonals, border: csr_matrix, damping: float = 0.0) -> FrontElimination | None:
        """Of a matrix, its scaled diagonal damped, and its border (size, p); None if it is not positive definite."""
        scale = root_of(band.main)
        if scale is None:
            return None
        unit = 1.0 / scale
        values = unit_diagonals(band, tree.offsets, unit, damping).reshape(-1)
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
    def operations(self) -> float:
        """See :attr:`Elimination.operations`."""
        sizes = np.array([under.shape for under in self.below], dtype=float)
        remaining, k = sizes.T
        return float(np.sum(k * (k + 1) * (2 * k + 1) / 6 + remaining * k**2 + k * remaining**2))

    @property
    def _log_pivots(self) -> float:
        return sum(float(np.log(np.diagonal(pivot)).sum()) for pivot in self.pivots)

    def half_solved(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Elimination.half_solved`."""
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
        """See :meth:`Elimination.solved`."""
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

    def inverse(self) -> Diagonals:
        """See :meth:`Elimination.inverse`."""
        out = np.zeros((len(self.tree.offsets), self.tree.size))
        flat = out.reshape(-1)
        roots: dict[int, np.ndarray] = {}
        for number in reversed(range(len(self.tree.fronts))):
            front, pivot = self.tree.fronts[number], self.pivots[number]
            m = len(front.boundary)
            boundary_root = roots.pop(number) if m else np.zeros((0, 0))
            root = root_of_inverse(pivot, self.below[number][:m], boundary_root)
            whole = root @ root.T
            column, row = front.cells(self.tree.band_target[front.band])
            flat[self.tree.band_source[front.band]] = whole[row, column]
            for child in (child for child in front.children if len(self.tree.fronts[child].boundary)):
                roots[child] = _taken(root, self.tree.fronts[child])
        return Diagonals(self.tree.offsets, out).over(self.scale)

    def _backward(self) -> zip[tuple[Front, np.ndarray, np.ndarray]]:
        return zip(reversed(self.tree.fronts), reversed(self.pivots), reversed(self.below), strict=True)


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
