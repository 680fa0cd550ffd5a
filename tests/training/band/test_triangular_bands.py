"""Many right-hand sides of a band by blocks: what a dense factor gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky_banded, solve_banded

from pinn_cli.training.band.triangular_bands import BLOCK, ENOUGH, solve_factored


def matrix(half_width: int, size: int) -> np.ndarray:
    """Lower band of a positive definite matrix, nonsense in the corner that no entry uses."""
    band = np.random.default_rng(0).normal(size=(half_width + 1, size))
    band[0] = 2.0 * np.abs(band).sum(axis=0).max()
    return band


@pytest.mark.parametrize("count", [0, 1, ENOUGH, 40])
@pytest.mark.parametrize(
    ("half_width", "size"), [(2 * BLOCK, 500), (2 * BLOCK + 7, 3 * BLOCK + 1), (200, 201), (5, 90)]
)
def test_solutions_are_those_of_the_band(half_width, size, count):
    band = matrix(half_width, size)
    right = np.random.default_rng(1).normal(size=(size, count))
    full = np.zeros((2 * half_width + 1, size))
    for k in range(half_width + 1):
        full[half_width + k, : size - k] = band[k, : size - k]
        full[half_width - k, k:] = band[k, : size - k]
    expected = solve_banded((half_width, half_width), full, right) if count else right
    before = right.copy()
    np.testing.assert_allclose(
        solve_factored(cholesky_banded(band, lower=True), right), expected, rtol=1e-9, atol=1e-13
    )
    np.testing.assert_array_equal(right, before)


def test_one_right_hand_side_has_one_dimension():
    band = matrix(150, 400)
    right = np.ones(400)
    alone = solve_factored(cholesky_banded(band, lower=True), right)
    together = solve_factored(cholesky_banded(band, lower=True), np.repeat(right[:, None], 20, axis=1))
    np.testing.assert_allclose(together, np.repeat(alone[:, None], 20, axis=1), rtol=1e-10)
