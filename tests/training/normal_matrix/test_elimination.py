"""Elimination in a band, and by fronts in orders that are chosen by counting, against dense linear algebra."""

import numpy as np
import pytest
from one_record import diagonals
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix

from pinn_cli.training.covariance import ENOUGH, is_alike, row_variance
from pinn_cli.training.normal_matrix.bordered import order_of_elimination
from pinn_cli.training.normal_matrix.dissection import Dissection, Grid
from pinn_cli.training.normal_matrix.elimination import Diagonals, Elimination, InBand
from pinn_cli.training.normal_matrix.front_elimination import FrontTree

# Parameters of a function, and the grids: cut across the functions first, across the features first, in slabs along
# either; functions that are coupled further, no parameters, one function, all in one front.
OWN = 2
GRIDS = {
    "functions": Grid(12, 40, 3, 2, 80),
    "features": Grid(60, 12, 3, 2, 24),
    "slabs": Grid(50, 3, 3, 1, 6),
    "along": Grid(5, 30, 4, 1, 6),
    "far": Grid(20, 15, 2, 4, 30),
    "none": Grid(30, 10, 3, 2, 0),
    "one": Grid(90, 1, 4, 0, 2),
    "leaf": Grid(4, 5, 3, 2, 10),
}


def matrices(grid: Grid) -> tuple[Diagonals, csr_matrix]:
    """A positive definite matrix of rows on the grid, its diagonal over eight decades, and a border."""
    rng, size = np.random.default_rng(grid.features), grid.features * grid.functions
    feature, function = np.divmod(np.arange(size), grid.functions)
    near = (np.abs(np.subtract.outer(feature, feature)) <= grid.span) & (
        np.abs(np.subtract.outer(function, function)) <= grid.reach
    )
    matrix = np.where(near, rng.normal(size=(size, size)), 0.0)
    matrix = np.tril(matrix, -1) + np.tril(matrix, -1).T
    matrix += np.diag(np.abs(matrix).sum(axis=1) * rng.uniform(1.01, 2.0, size))
    scale = 10.0 ** rng.uniform(-2.0, 2.0, size)
    matrix *= scale[:, None] * scale
    band = diagonals(matrix, np.unique(np.abs(np.subtract(*np.nonzero(near)))))
    touched = np.minimum(function[:, None] + np.arange(2), grid.functions - 1)[:, :, None] * OWN + np.arange(OWN)
    border = np.zeros((size, grid.functions * OWN))
    border[np.arange(size)[:, None], touched.reshape(size, -1)] = rng.normal(size=(size, 2 * OWN)) * scale[:, None]
    return band, csr_matrix(border[:, : grid.parameters])


def in_fronts(grid: Grid, border: csr_matrix, largest: int = 40) -> FrontTree:
    return FrontTree(grid, Dissection(grid, largest).tree(), border)


ORDERS = {"fronts": in_fronts, "band": lambda grid, border: InBand(grid, border.shape[1])}
in_every_order = pytest.mark.parametrize("order", ORDERS)


def eliminated(grid: Grid, order: str, damping: float = 0.0) -> tuple[Elimination, np.ndarray, np.ndarray]:
    """With the same as dense matrices."""
    band, border = matrices(grid)
    found = ORDERS[order](grid, border).eliminated(band, border, damping)
    assert found is not None
    dense = band.dense()
    return found, dense + damping * np.diag(np.diag(dense)), border.toarray()


def test_the_grids_are_eliminated_in_the_orders_that_they_stand_for():
    found = {name: Dissection(grid, largest=40).best for name, grid in GRIDS.items()}
    assert {name: (best.how, best.axis) for name, best in found.items() if name not in ("far", "none", "one")} == {
        "functions": ("halves", "functions"),
        "features": ("halves", "features"),
        "slabs": ("slabs", "features"),
        "along": ("slabs", "functions"),
        "leaf": ("leaf", "features"),
    }


@pytest.mark.parametrize("name", GRIDS)
def test_every_weight_is_eliminated_once(name):
    tree = in_fronts(GRIDS[name], matrices(GRIDS[name])[1])
    np.testing.assert_array_equal(np.sort(tree.order), np.arange(tree.size))
    assert len(tree.fronts) > (name != "leaf")


@in_every_order
@pytest.mark.parametrize("name", GRIDS)
def test_log_determinant_and_what_the_border_leaves(name, order):
    found, dense, border = eliminated(GRIDS[name], order)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-10)
    expected = border.T @ np.linalg.solve(dense, border)
    np.testing.assert_allclose(found.border_gram, expected, atol=1e-10 * np.abs(expected).max(initial=0.0))


@in_every_order
@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("name", GRIDS)
def test_a_solution_leaves_no_residual(name, damping, order):
    found, dense, border = eliminated(GRIDS[name], order, damping)
    rng, root = np.random.default_rng(0), np.sqrt(np.diag(dense))
    right, x = rng.normal(size=(found.size, 3)) * root[:, None], rng.normal(size=(border.shape[1], 3))
    half, taken = found.half_solved(right)
    solution = found.solved(half, x)
    np.testing.assert_allclose((dense @ solution - right - border @ x) / root[:, None], 0.0, atol=1e-10)
    np.testing.assert_allclose(taken, border.T @ np.linalg.solve(dense, right), atol=1e-9)
    np.testing.assert_allclose(np.sum(half**2), np.sum(right * np.linalg.solve(dense, right)), rtol=1e-9)
    one = found.half_solved(right[:, 0])
    assert [part.shape for part in one] == [(found.size,), (border.shape[1],)]
    np.testing.assert_allclose(found.solved(one[0], x[:, 0]), solution[:, 0], rtol=1e-12)
    np.testing.assert_allclose(found.solved_border, np.linalg.solve(dense, border), atol=1e-9 / root.min())


@in_every_order
@pytest.mark.parametrize("name", GRIDS)
def test_the_inverse_wherever_two_weights_meet(name, order):
    found, dense, _ = eliminated(GRIDS[name], order)
    row, column = np.nonzero(dense)
    expected = np.linalg.inv(dense)
    scale = np.sqrt(np.diag(expected))
    given = found.inverse().at(row, column)
    np.testing.assert_allclose(
        given / scale[row] / scale[column], (expected / scale / scale[:, None])[row, column], atol=1e-10
    )


@pytest.mark.parametrize("name", GRIDS)
def test_operations_are_those_of_elimination_entry_by_entry(name):
    """Of one front, which is dense: of every entry that a column changes an addition and a multiplication."""
    grid = GRIDS[name]
    band, border = matrices(grid)
    found, counted = in_fronts(grid, border, band.size).eliminated(band, border), 0
    for pivot, below in zip(found.pivots, found.below, strict=True):
        counted += sum((len(pivot) + len(below) - column) ** 2 for column in range(len(pivot)))
    assert found.operations == pytest.approx(counted, rel=0.1)
    width, parameters = int(grid.offsets[-1]), border.shape[1]
    in_band = ORDERS["band"](grid, border).eliminated(band, border)
    assert in_band.operations == band.size * (1 + width + parameters) ** 2


@in_every_order
@pytest.mark.parametrize("name", GRIDS)
def test_what_is_not_positive_definite_is_refused(name, order):
    band, border = matrices(GRIDS[name])
    for at, value in ((band.size // 2, -1.0), (0, np.nan)):
        main = band.values.copy()
        main[0, at] *= value
        assert ORDERS[order](GRIDS[name], border).eliminated(Diagonals(band.offsets, main), border) is None
    indefinite = band.values.copy()
    indefinite[0] *= 1e-3
    assert ORDERS[order](GRIDS[name], border).eliminated(Diagonals(band.offsets, indefinite), border) is None


def test_the_cheapest_order_is_taken():
    """Of a long record of few functions in their band; of many functions by dissection."""
    for functions, how in ((3, InBand), (40, FrontTree)):
        grid = Grid(600, functions, 6, 2, 3)
        assert isinstance(order_of_elimination(Dissection(grid), csr_matrix((grid.size, 3))), how)


def test_the_same_tree_serves_another_border_at_the_same_places():
    grid = GRIDS["features"]
    band, border = matrices(grid)
    tree = in_fronts(grid, border)
    zeros = border.copy()
    zeros.data[::3] = 0.0
    assert tree.suits(2.0 * border)
    assert tree.suits(zeros)
    assert not tree.suits(border[:, :3])
    expected = zeros.toarray().T @ np.linalg.solve(band.dense(), zeros.toarray())
    np.testing.assert_allclose(tree.eliminated(band, zeros).border_gram, expected, rtol=1e-9, atol=1e-12)


@in_every_order
def test_rows_that_reach_further_than_the_coupling_says_are_refused(order):
    band, border = matrices(Grid(60, 12, 3, 3, 24))
    with pytest.raises(IndexError, match="further apart than the structure's coupling"):
        ORDERS[order](GRIDS["features"], border).eliminated(band, border)


def test_operations_grow_as_they_do_for_a_plane_grid():
    """Nested dissection of a square grid of N weights takes N^1.5; a band takes N^2."""
    few, many = (Dissection(Grid(2 * n, n, 4, 2, 3 * n)).best.cost for n in (200, 800))
    assert np.log(many / few) / np.log(4.0) < 3.2


@in_every_order
def test_a_curvature_that_is_known_far_better_than_the_weights_has_its_variance(order):
    """Of coupled splines whose values are measured seldom: it was up to thousands of times as large, or negative."""
    count, functions, degree, known = 400, 3, 6, 1e5
    time, knots = np.arange(count - degree) + 0.37, np.arange(-degree, count + 1.0)
    value, curvature = (BSpline(knots, np.eye(count), degree).derivative(order)(time) for order in (0, 2))
    coupling = np.vstack((np.eye(functions), 10.0 * (np.eye(functions) - 0.5 * np.eye(functions, k=-1))[1:]))
    rows = np.vstack((known * np.kron(curvature, coupling), np.kron(value[::7], np.eye(functions))))
    matrix = rows.T @ rows
    grid = Grid(count, functions, degree, 1, 0)
    band, border = diagonals(matrix, grid.offsets), csr_matrix((len(matrix), 0))
    wanted = np.kron(curvature, np.eye(functions)[-1:])
    factor = ORDERS[order](grid, border).eliminated(band, border)
    half, _ = factor.half_solved(wanted.T)
    variance = np.sum((wanted @ factor.inverse().dense()) * wanted, axis=1)
    assert variance == pytest.approx(np.sum(half**2, axis=0), rel=0.02, abs=0.0)


FUNCTIONS, WIDTH = 2, 5


def dense_and_band(size: int) -> tuple[np.ndarray, Diagonals]:
    """The inverse of a positive definite band, and of it the band."""
    rng = np.random.default_rng(0)
    lower = np.tril(np.triu(rng.normal(size=(size, size)), -WIDTH)) + 6.0 * np.eye(size)
    inverse = np.linalg.inv(lower @ lower.T)
    return inverse, diagonals(inverse, np.arange(WIDTH + 1))


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
