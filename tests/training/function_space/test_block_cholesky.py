import numpy as np
import pytest
import torch

from pinn_cli.training.function_space.block_cholesky import BlockCholesky, BlockPattern, Blocks, entry

# Block rows of unequal heights: of every row of the matrix the block row.
HEIGHTS = [4, 3, 5, 4, 1]
OF = torch.arange(5).repeat_interleave(torch.tensor(HEIGHTS))
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
    pattern = BlockPattern(coupled(name))
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(len(OF), len(OF), generator=generator, dtype=torch.float64)
    mask = torch.as_tensor(coupled(name))[OF][:, OF]
    matrix = (noise + noise.T) * mask
    matrix += 20.0 * torch.eye(len(matrix))
    there = zip(*np.nonzero(np.tril(coupled(name))), strict=True)
    return matrix, pattern, {(int(i), int(j)): matrix[i == OF][:, j == OF].clone() for i, j in there}


@pytest.mark.parametrize("name", COUPLINGS)
def test_it_solves_what_dense_algebra_solves(name):
    matrix, pattern, blocks = matrix_and_blocks(name)
    factor = BlockCholesky(pattern, blocks)
    right = torch.randn(len(OF), 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    expected = torch.linalg.solve(matrix, right)
    torch.testing.assert_close(torch.cat(factor.solved(list(right.split(HEIGHTS)))), expected)
    half = torch.cat(factor.forward(list(right.split(HEIGHTS))))
    torch.testing.assert_close(half.T @ half, right.T @ expected)


@pytest.mark.parametrize("name", COUPLINGS)
def test_the_blocks_of_the_inverse(name):
    matrix, pattern, blocks = matrix_and_blocks(name)
    found = BlockCholesky(pattern, blocks).inverse
    inverse = torch.linalg.inv(matrix)
    for i, j in zip(*np.nonzero(coupled(name)), strict=True):
        expected = inverse[i == OF][:, j == OF]
        torch.testing.assert_close(entry(found, i, j), expected)


def test_a_chain_and_a_star_fill_nothing_in():
    assert [len(later) for later in BlockPattern(coupled("chain")).below] == [1, 1, 1, 1, 0]
    assert sum(len(later) for later in BlockPattern(coupled("star")).below) == 4
    assert BlockPattern(coupled("chain")).operations < 0.5 * BlockPattern(coupled("whole")).operations


def test_the_whole_matrix_takes_a_third_of_its_cube():
    dense = BlockPattern(np.ones((12, 12), dtype=bool)).operations
    assert dense == pytest.approx(12**3 / 3, rel=0.15)


def test_what_is_not_positive_definite_is_refused():
    _, pattern, blocks = matrix_and_blocks("chain")
    blocks[2, 2] -= 100.0 * torch.eye(HEIGHTS[2])
    with pytest.raises(FloatingPointError):
        BlockCholesky(pattern, blocks)
