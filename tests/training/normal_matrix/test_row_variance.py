"""Variances line by line are those of the dense inverse."""

import numpy as np
import pytest

from pinn_cli.training.covariance import ENOUGH, is_alike, row_variance
from pinn_cli.training.normal_matrix.diagonals import Diagonals

FUNCTIONS, WIDTH = 2, 5


def dense_and_band(size: int) -> tuple[np.ndarray, Diagonals]:
    """The inverse of a positive definite band, and of it the band."""
    rng = np.random.default_rng(0)
    lower = np.tril(np.triu(rng.normal(size=(size, size)), -WIDTH)) + 6.0 * np.eye(size)
    inverse = np.linalg.inv(lower @ lower.T)
    values = np.zeros((WIDTH + 1, size))
    for k in range(WIDTH + 1):
        values[k, : size - k] = np.diag(inverse, -k)
    return inverse, Diagonals(np.arange(WIDTH + 1), values)


@pytest.mark.parametrize("evenly", [True, False])
def test_the_variance_of_rows_is_that_of_the_dense_inverse(evenly):
    (inverse, band), rng = dense_and_band(200), np.random.default_rng(1)
    first = FUNCTIONS * np.arange(97) if evenly else np.sort(rng.integers(0, 194, 60))
    position = first[:, None] + np.array([1, 0, 3, 1, 4])
    rows = rng.normal(size=(len(first), 3, 5))
    rows[..., 3] = 0.0  # a slot that is not used
    carried, given = rng.normal(size=(2, 200)), rng.normal(size=(len(first), 3, 2))
    found = row_variance(band, carried, position, rows, given)
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
