import numpy as np
import pytest
import torch
from scipy.sparse import csr_matrix

from pinn_cli.system.coupling import Coupling
from pinn_cli.training.normal_matrix.row_sums import FullRows, RowSums

FUNCTIONS, PLACES, COUNT = 3, 2, 14


def coupling() -> Coupling:
    """All functions with each other."""
    rows = csr_matrix(np.ones((1, FUNCTIONS)))
    return Coupling(rows, rows)


@pytest.mark.parametrize(
    ("stride", "features", "first"),
    [
        pytest.param(1, 4, np.arange(3, 11), id="a spline"),
        pytest.param(2, 4, np.arange(0, 12, 2), id="two outputs of a function"),
        pytest.param(1, 5, np.array([0, 1, 2, 5, 6, 7, 8, 9]), id="a gap"),
        pytest.param(1, 6, np.arange(2, 5), id="fewer groups than features"),
        pytest.param(1, 14, np.zeros(5, dtype=np.int64), id="features of the whole record"),
    ],
)
def test_sums_are_those_of_a_dense_matrix(stride, features, first):
    random = np.random.default_rng(0)
    rows, by = random.normal(size=(len(first), 4, features, FUNCTIONS)), random.normal(size=(len(first), 4, PLACES + 1))
    gram, constant = random.normal(size=(len(first), features, features)), random.normal(size=(FUNCTIONS, FUNCTIONS))
    gram, constant = gram + gram.swapaxes(1, 2), constant + constant.T
    feature = torch.as_tensor(first[:, None] + np.arange(features))
    sums = RowSums(stride, features, COUNT, coupling(), PLACES)
    half = len(first) // 2
    for part in (slice(0, half), slice(half, None)):
        sums.add_full(FullRows(feature[part], rows[part], by[part], np.ones((FUNCTIONS, PLACES), dtype=bool)))
    sums.add_constant(feature, gram, csr_matrix(constant))
    sums.add_diagonal(0.5, np.ones(COUNT * FUNCTIONS))

    order = np.argsort(sums.rank)
    jacobian = np.zeros((len(first), 4, COUNT, FUNCTIONS))
    expected = 0.5 * np.eye(COUNT * FUNCTIONS)
    for group, at in enumerate(feature.numpy()):
        jacobian[group][:, at] = rows[group]
        placed = np.zeros((COUNT, FUNCTIONS, COUNT, FUNCTIONS))
        placed[np.ix_(at, range(FUNCTIONS), at, range(FUNCTIONS))] = np.einsum(
            "ab,ij->aibj", gram[group], constant[np.ix_(order, order)]
        )
        expected += placed.reshape(expected.shape)
    flat, beside = jacobian.reshape(-1, COUNT * FUNCTIONS), by.reshape(-1, PLACES + 1)
    expected += flat.T @ flat
    np.testing.assert_allclose(sums.band.dense(), expected, atol=1e-12)
    np.testing.assert_allclose(sums.main, np.diag(expected), atol=1e-12)
    np.testing.assert_allclose(sums.border(np.arange(PLACES)).toarray(), flat.T @ beside[:, :-1], atol=1e-12)
    np.testing.assert_allclose(sums.gradient, flat.T @ beside[:, -1] + 0.5, atol=1e-12)
    np.testing.assert_allclose(sums.corner, beside[:, :-1].T @ beside[:, :-1], atol=1e-12)
    np.testing.assert_allclose(sums.slope, beside[:, :-1].T @ beside[:, -1], atol=1e-12)
