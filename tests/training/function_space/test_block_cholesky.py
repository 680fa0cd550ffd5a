from __future__ import annotations

import numpy as np
import pytest
import torch

from pinn_cli.training.function_space.block_cholesky import BlockCholesky, BlockPattern, Blocks, entry

SIZE = 4
# A chain, one whose ends meet, a star and a tree, and blocks that do not know each other.
COUPLINGS = {
    "chain": [(0, 1), (1, 2), (2, 3), (3, 4)],
    "ring": [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)],
    "star": [(0, 1), (0, 2), (0, 3), (0, 4)],
    "apart": [(0, 3)],
    "whole": [(i, j) for i in range(5) for j in range(i)],
}


def coupled(name: str) -> np.ndarray:
    out = np.eye(5, dtype=bool)
    for i, j in COUPLINGS[name]:
        out[i, j] = out[j, i] = True
    return out


def matrix_and_blocks(name: str) -> tuple[torch.Tensor, BlockPattern, Blocks]:
    """In the order of elimination."""
    pattern = BlockPattern(coupled(name))
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(5 * SIZE, 5 * SIZE, generator=generator, dtype=torch.float64)
    mask = torch.as_tensor(coupled(name)[np.ix_(pattern.order, pattern.order)]).repeat_interleave(SIZE, 0)
    matrix = (noise + noise.T) * mask.repeat_interleave(SIZE, 1)
    matrix += 20.0 * torch.eye(len(matrix))
    cut = [slice(SIZE * i, SIZE * (i + 1)) for i in range(5)]
    return matrix, pattern, {(i, j): matrix[cut[i], cut[j]].clone() for i, j in pattern.places}


@pytest.mark.parametrize("name", COUPLINGS)
def test_it_solves_what_dense_algebra_solves(name):
    matrix, pattern, blocks = matrix_and_blocks(name)
    factor = BlockCholesky(pattern, blocks)
    right = torch.randn(5, SIZE, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    expected = torch.linalg.solve(matrix, right.flatten(0, 1))
    torch.testing.assert_close(factor.solved(right).flatten(0, 1), expected)
    half = factor.forward(right).flatten(0, 1)
    torch.testing.assert_close(half.T @ half, right.flatten(0, 1).T @ expected)


@pytest.mark.parametrize("name", COUPLINGS)
def test_the_blocks_of_the_inverse(name):
    matrix, pattern, blocks = matrix_and_blocks(name)
    found = BlockCholesky(pattern, blocks).inverse
    inverse = torch.linalg.inv(matrix)
    for i, j in pattern.places:
        expected = inverse[SIZE * i : SIZE * (i + 1), SIZE * j : SIZE * (j + 1)]
        torch.testing.assert_close(entry(found, i, j), expected)
        torch.testing.assert_close(entry(found, j, i), expected.T)


def test_a_chain_and_a_star_fill_nothing_in():
    assert [len(later) for later in BlockPattern(coupled("chain")).below] == [1, 1, 1, 1, 0]
    assert sum(len(later) for later in BlockPattern(coupled("star")).below) == 4
    assert BlockPattern(coupled("chain")).operations < 0.5 * BlockPattern(coupled("whole")).operations


def test_the_whole_matrix_takes_a_third_of_its_cube():
    dense = BlockPattern(np.ones((12, 12), dtype=bool)).operations
    assert dense == pytest.approx(12**3 / 3, rel=0.15)


def test_what_is_not_positive_definite_is_refused():
    _, pattern, blocks = matrix_and_blocks("chain")
    blocks[2, 2] -= 100.0 * torch.eye(SIZE)
    with pytest.raises(FloatingPointError):
        BlockCholesky(pattern, blocks)
