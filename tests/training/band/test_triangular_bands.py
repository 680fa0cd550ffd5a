"""Many right-hand sides of a triangular band by blocks: what a dense factor gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky_banded, solve_triangular

from pinn_cli.training.band.triangular_bands import BLOCK, ENOUGH, WIDE, backward, forward

# Bands wider and narrower than a block, sizes that are no multiple of one, a band as wide as the matrix, a few rows.
SHAPES = [
    (2 * BLOCK, 500),
    (2 * BLOCK + 7, 3 * BLOCK + 1),
    (200, 201),
    (BLOCK, 300),
    (WIDE, 230),
    (WIDE + 5, 70),
    (5, 90),
    (0, 9),
]


def factor(half_width: int, size: int) -> np.ndarray:
    """The factor of a positive definite matrix, nonsense in the corner that no entry uses."""
    band = np.random.default_rng(0).normal(size=(half_width + 1, size))
    band[0] = 2.0 * np.abs(band).sum(axis=0).max()
    found = np.asfortranarray(cholesky_banded(band, lower=True))
    for k in range(half_width + 1):
        found[k, size - k :] = np.nan
    return found


def dense(band: np.ndarray) -> np.ndarray:
    size = band.shape[1]
    return sum(np.diag(band[k, : size - k], -k) for k in range(min(len(band), size)))


@pytest.mark.parametrize("count", [0, 1, ENOUGH, 40])
@pytest.mark.parametrize(("half_width", "size"), SHAPES)
def test_solutions_are_those_of_a_dense_triangle(half_width, size, count):
    band = factor(half_width, size)
    right = np.random.default_rng(1).normal(size=(size, count))
    before, lower = right.copy(), dense(band)
    for solve, transposed in ((forward, "N"), (backward, "T")):
        expected = solve_triangular(lower, right, lower=True, trans=transposed) if count else right
        np.testing.assert_allclose(solve(band, right), expected, rtol=1e-9, atol=1e-13)
        np.testing.assert_array_equal(right, before)


def test_one_right_hand_side_has_one_dimension():
    band, right = factor(150, 400), np.ones(400)
    for solve in (forward, backward):
        together = solve(band, np.repeat(right[:, None], 20, axis=1))
        np.testing.assert_allclose(together, np.repeat(solve(band, right)[:, None], 20, axis=1), rtol=1e-10)
