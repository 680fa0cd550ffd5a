import numpy as np
import pytest
import torch
from scipy.sparse import csr_matrix

from pinn_cli.system.coupling import Coupling
from pinn_cli.training.normal_matrix.row_sums import FullRows, RowSums
from pinn_cli.training.normal_matrix.separable_rows import LocalFeatures, SeparableRows

FUNCTIONS, PLACES, COUNT, ORDERS = 3, 2, 14, 2


def coupling() -> Coupling:
    """All functions with each other."""
    rows = csr_matrix(np.ones((1, FUNCTIONS)))
    return Coupling(rows, rows)


@pytest.mark.parametrize("changing", [False, True], ids=["constant weights", "weights that change"])
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
def test_sums_are_those_of_a_dense_matrix(stride, features, first, changing):
    random = np.random.default_rng(0)
    rows, by = random.normal(size=(len(first), 4, features, FUNCTIONS)), random.normal(size=(len(first), 4, PLACES + 1))
    feature, every = torch.as_tensor(first[:, None] + np.arange(features)), np.ones((FUNCTIONS, PLACES), dtype=bool)
    sums = RowSums(stride, features, COUNT, coupling(), PLACES)
    half = len(first) // 2
    for part in (slice(0, half), slice(half, None)):
        sums.add_full(FullRows(feature[part], rows[part], by[part], every))

    values = random.normal(size=(len(first), 2, ORDERS, features))
    by_motion, more = random.normal(size=(ORDERS, FUNCTIONS, FUNCTIONS)), random.normal(size=(len(first), 2, 3, 3))
    weight = random.uniform(1.0, 2.0, FUNCTIONS)
    if changing:
        weight = np.stack([weight] * len(first))
        weight[:, 1] = random.uniform(1.0, 2.0, len(first))
    named = np.array([[True, False, True], [True, True, True], [False, True, True]])
    local = LocalFeatures(feature, torch.as_tensor(values))
    touching = np.any(by_motion, axis=0)
    places = np.where(named, np.arange(PLACES + 1), -1)
    sums.add_separable(SeparableRows(local, by_motion, touching, weight, more * named, places, PLACES))
    sums.add_diagonal(0.5, np.ones(COUNT * FUNCTIONS))

    order = np.argsort(sums.rank)
    root = np.sqrt(weight)[..., None] if not changing else np.sqrt(weight)[:, None, :, None]
    separable = np.einsum("isob,okj->iskbj", values, by_motion[..., order]) * root[..., None]
    flat = [np.zeros((len(first), n, COUNT, FUNCTIONS)) for n in (4, 2 * FUNCTIONS)]
    for group, at in enumerate(feature.numpy()):
        flat[0][group][:, at] = rows[group]
        flat[1][group][:, at] = separable[group].reshape(2 * FUNCTIONS, features, FUNCTIONS)
    jacobian = np.concatenate([x.reshape(-1, COUNT * FUNCTIONS) for x in flat])
    beside = np.concatenate((by.reshape(-1, PLACES + 1), (more * named * root).reshape(-1, PLACES + 1)))
    expected = jacobian.T @ jacobian + 0.5 * np.eye(COUNT * FUNCTIONS)
    np.testing.assert_allclose(sums.band.dense(), expected, atol=1e-12)
    np.testing.assert_allclose(sums.main, np.diag(expected), atol=1e-12)
    np.testing.assert_allclose(sums.border(np.arange(PLACES)).toarray(), jacobian.T @ beside[:, :-1], atol=1e-12)
    np.testing.assert_allclose(sums.gradient, jacobian.T @ beside[:, -1] + 0.5, atol=1e-12)
    np.testing.assert_allclose(sums.corner, beside[:, :-1].T @ beside[:, :-1], atol=1e-12)
    np.testing.assert_allclose(sums.slope, beside[:, :-1].T @ beside[:, -1], atol=1e-12)
