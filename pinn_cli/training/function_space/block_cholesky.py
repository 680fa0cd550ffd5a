"""Cholesky factor of a symmetric matrix of few large blocks, of which most may be zero."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee
from torch import Tensor

Blocks = dict[tuple[int, int], Tensor]
"""Those of the lower triangle that are not zero, by row and column; every row of blocks has a height of its own."""


class BlockPattern:
    """Which blocks of a matrix are not zero, and which of its factor.

    Args:
        coupled: (n, n) booleans, symmetric.

    Attributes:
        order: (n,), which block row is eliminated when: reverse Cuthill-McKee.
        below: By step of the elimination, the later steps whose block in that column of the factor is not zero.
    """

    def __init__(self, coupled: np.ndarray) -> None:
        count = len(coupled)
        self.order = reverse_cuthill_mckee(csr_matrix(coupled.astype(np.int8)), symmetric_mode=True).tolist()
        filled = coupled[np.ix_(self.order, self.order)].copy()
        self.below: list[list[int]] = []
        for step in range(count):
            later = [row for row in range(step + 1, count) if filled[row, step]]
            filled[np.ix_(later, later)] = True
            self.below.append(later)

    @property
    def places(self) -> list[tuple[int, int]]:
        """Of the factor's blocks, in the order of elimination."""
        return [(row, step) for step, later in enumerate(self.below) for row in (step, *later)]

    @property
    def operations(self) -> float:
        """Of a factorisation, in multiplications and additions of blocks of size one: times F^3."""
        return sum(1.0 / 3.0 + len(later) + len(later) * (len(later) + 1) for later in self.below)


class BlockCholesky:
    """The factor L of a positive definite matrix. Between two blocks Python looks at signals.

    Args:
        pattern: Of the matrix.
        blocks: The matrix; overwritten by the factor.

    Raises:
        FloatingPointError: It is not positive definite in its precision.
    """

    def __init__(self, pattern: BlockPattern, blocks: Blocks) -> None:
        self.pattern, self.blocks = pattern, {}
        for row, step in pattern.places:
            i, j = pattern.order[row], pattern.order[step]
            is_zero = (max(i, j), min(i, j)) not in blocks
            diagonal = blocks[i, i]
            self.blocks[row, step] = (
                diagonal.new_zeros(len(diagonal), len(blocks[j, j])) if is_zero else entry(blocks, i, j)
            )
        for step, later in enumerate(pattern.below):
            top, failed = torch.linalg.cholesky_ex(self.blocks[step, step])
            if int(failed):
                raise FloatingPointError("not positive definite")
            self.blocks[step, step] = top
            for row in later:
                beneath = self.blocks[row, step]
                self.blocks[row, step] = torch.linalg.solve_triangular(top, beneath.mT, upper=False).mT
            for i, row in enumerate(later):
                for column in later[: i + 1]:
                    self.blocks[row, column].addmm_(self.blocks[row, step], self.blocks[column, step].mT, alpha=-1)

    def solved(self, right: list[Tensor]) -> list[Tensor]:
        """The inverse times a matrix, row by row of blocks."""
        half = self.forward(right)
        for step in reversed(range(len(half))):
            for row in self.pattern.below[step]:
                half[step].addmm_(self.blocks[row, step].mT, half[row], alpha=-1)
            half[step] = torch.linalg.solve_triangular(self.blocks[step, step].mT, half[step], upper=True)
        out = list(half)
        for step, row in enumerate(self.pattern.order):
            out[row] = half[step]
        return out

    def forward(self, right: list[Tensor]) -> list[Tensor]:
        """L^-1 times a matrix, row by row of blocks, in the order of elimination."""
        out = [right[row].clone() for row in self.pattern.order]
        for step, later in enumerate(self.pattern.below):
            out[step] = torch.linalg.solve_triangular(self.blocks[step, step], out[step], upper=False)
            for row in later:
                out[row].addmm_(self.blocks[row, step], out[step], alpha=-1)
        return out

    @cached_property
    def inverse(self) -> Blocks:
        """The blocks of the inverse where those of the factor are (Takahashi, Fagan and Chin 1973)."""
        blocks: Blocks = {}
        for step in reversed(range(len(self.pattern.below))):
            top, later = self.blocks[step, step], self.pattern.below[step]
            diagonal = torch.cholesky_inverse(top)
            if later:
                beneath = torch.cat([self.blocks[row, step] for row in later])
                ratio = torch.linalg.solve_triangular(top, beneath, upper=False, left=False)
                later_blocks = torch.cat(
                    [torch.cat([entry(blocks, row, column) for column in later], 1) for row in later]
                )
                across = later_blocks @ ratio
                diagonal += ratio.mT @ across
                heights = [len(self.blocks[row, row]) for row in later]
                for row, block in zip(later, across.split(heights), strict=True):
                    blocks[row, step] = -block
            blocks[step, step] = diagonal
        order = self.pattern.order
        return {(order[row], order[step]): block for (row, step), block in blocks.items()}


def entry(blocks: Blocks, row: int, column: int) -> Tensor:
    """A block of either triangle."""
    return blocks[row, column] if (row, column) in blocks else blocks[column, row].mT
