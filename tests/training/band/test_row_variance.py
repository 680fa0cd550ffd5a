"""Variances line by line are those of the dense inverse."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.training.band.band_factor import BandFactor
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.row_variance import ENOUGH, is_alike, row_variance

FUNCTIONS, WIDTH = 2, 5


def dense_and_band(size: int) -> tuple[np.ndarray, BandFactor]:
    """A positive definite band, and its factor."""
    rng = np.random.default_rng(0)
    lower = np.tril(np.triu(rng.normal(size=(size, size)), -WIDTH)) + 6.0 * np.eye(size)
    matrix = lower @ lower.T
    band = np.zeros((WIDTH + 1, size))
    for k in range(WIDTH + 1):
        band[k, : size - k] = np.diag(matrix, -k)
    factor = BandFactor.of(Diagonals.of_band(band))
    assert factor is not None
    return matrix, factor


@pytest.mark.parametrize("size", [WIDTH + 1, 31, 32, 33, 64, 200, 203])
def test_the_band_of_the_inverse_is_that_of_the_dense_one(size):
    matrix, factor = dense_and_band(size)
    inverse, band = np.linalg.inv(matrix), factor.inverse_band()
    for k, line in enumerate(band):
        assert line[: size - k] == pytest.approx(np.diag(inverse, -k), rel=1e-10, abs=1e-14)


@pytest.mark.parametrize("evenly", [True, False])
def test_the_variance_of_rows_is_that_of_the_dense_inverse(evenly):
    matrix, factor = dense_and_band(200)
    rng, inverse = np.random.default_rng(1), np.linalg.inv(matrix)
    first = FUNCTIONS * np.arange(97) if evenly else np.sort(rng.integers(0, 194, 60))
    position = first[:, None] + np.array([1, 0, 3, 1, 4])
    rows = rng.normal(size=(len(first), 3, 5))
    rows[..., 3] = 0.0  # a slot that is not used
    carried, given = rng.normal(size=(2, 200)), rng.normal(size=(len(first), 3, 2))
    found = row_variance(Diagonals.of_band(factor.inverse_band()), carried, position, rows, given)
    for group, at in enumerate(position):
        through = given[group] - rows[group] @ carried[:, at].T
        wanted = np.einsum("sc,cd,sd->s", rows[group], inverse[np.ix_(at, at)], rows[group]) + (through**2).sum(-1)
        assert found[group] == pytest.approx(wanted, rel=1e-9)


def test_few_groups_and_uneven_ones_are_not_taken_by_lines():
    even = np.arange(ENOUGH)[:, None] + np.arange(4)
    uneven = even.copy()
    uneven[7, 2] += 1
    assert is_alike(even)
    assert not is_alike(even[1:])
    assert not is_alike(uneven)
