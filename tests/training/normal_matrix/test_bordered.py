"""Systems with a border against dense linear algebra."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from one_record import diagonals, factored, shared
from scipy.sparse import csr_matrix

from pinn_cli.training.normal_matrix.bordered import BorderedSystem
from pinn_cli.training.normal_matrix.dissection import Dissection, Grid
from pinn_cli.training.normal_matrix.front_elimination import FrontTree

# Half-width, size, border: diagonal, narrow, size no multiple of the width, band as wide as the matrix.
SHAPES = [(0, 7, 0), (0, 7, 2), (1, 9, 3), (2, 23, 0), (3, 24, 1), (5, 31, 4), (7, 8, 2), (4, 4, 0), (1, 1, 1)]


def in_slabs(half_width: int, border: np.ndarray) -> FrontTree:
    """An order of elimination of a band, with several fronts where it is not as wide as the matrix."""
    grid = Grid(len(border), 1, min(half_width, len(border) - 1), 0, border.shape[1])
    return FrontTree(grid, Dissection(grid, largest=5).tree(), csr_matrix(border))


def random_system(half_width: int, size: int, border: int) -> tuple[BorderedSystem, np.ndarray]:
    """A positive definite system whose diagonal spans eight decades, and the same as a dense matrix."""
    rng = np.random.default_rng([half_width, size, border])
    offset = np.subtract.outer(np.arange(size), np.arange(size))
    whole = np.zeros((size + border, size + border))
    lower = np.where((offset >= 0) & (offset <= half_width), rng.normal(size=(size, size)), 0.0)
    whole[:size, :size] = lower @ lower.T + 0.3 * np.eye(size)
    whole[:size, size:] = 0.1 * rng.normal(size=(size, border))
    whole[size:, :size] = whole[:size, size:].T
    whole[size:, size:] = np.eye(border) + whole[size:, :size] @ np.linalg.solve(
        whole[:size, :size], whole[:size, size:]
    )
    scale = 10.0 ** rng.uniform(-2.0, 2.0, size + border)
    whole *= scale[:, None] * scale
    gradient = rng.normal(size=size + border) * scale
    band = diagonals(whole[:size, :size], np.arange(min(half_width, size - 1) + 1))
    corner, order = whole[size:, size:], in_slabs(half_width, whole[:size, size:])
    return BorderedSystem(band, order.border, corner, gradient[:size], gradient[size:], order), whole


def solved(system: BorderedSystem, lower: np.ndarray | None = None, damping: float = 0.0):
    whole = shared(system)
    return whole.factor(damping).step(whole, lower)


@pytest.mark.parametrize(("half_width", "size", "border"), SHAPES)
def test_step(half_width, size, border):
    system, whole = random_system(half_width, size, border)
    expected = -np.linalg.solve(whole, np.concatenate((system.gradient, system.corner_gradient)))
    step = solved(system)
    assert [x.shape for x in step] == [(size,), (border,)]
    np.testing.assert_allclose(np.concatenate(step), expected, rtol=1e-8)
    held = -np.linalg.solve(whole[:size, :size], system.gradient)
    np.testing.assert_allclose(system.readout_step(), held, rtol=1e-8)


@pytest.mark.parametrize(("half_width", "size", "border"), SHAPES)
def test_determinant_covariance_and_draws(half_width, size, border):
    system, whole = random_system(half_width, size, border)
    factor, covariance = shared(system).factor(), np.linalg.inv(whole)
    found = factor.parameter_log_determinant + factor.determinants[0]
    assert found == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-8)
    unit = np.sqrt(np.diag(covariance))
    correlation, own = covariance / unit / unit[:, None], unit[size:]
    np.testing.assert_allclose(factor.corner_covariance / own / own[:, None], correlation[size:, size:], atol=1e-8)
    root = np.vstack(factored(system).draws(np.eye(size + border)))
    np.testing.assert_allclose(root @ root.T / unit / unit[:, None], correlation, atol=1e-8)


@pytest.mark.parametrize("spoil", ["indefinite band", "indefinite corner", "zero", "nan"])
def test_what_is_not_positive_definite_has_no_factor(spoil):
    system, _ = random_system(2, 10, 2)
    if spoil == "indefinite band":
        system.band.values[1] = 10.0 * np.sqrt(system.band.main)[0] * np.abs(system.band.values[1]).max()
    elif spoil == "indefinite corner":
        system.corner[:] -= 10.0 * np.diag(np.diag(system.corner))
    else:
        system.band.main[3] = 0.0 if spoil == "zero" else np.nan
    assert shared(system).factor() is None
    assert spoil == "indefinite corner" or system.readout_step() is None


def coupled_system(border: int, seed: int, push: float) -> tuple[BorderedSystem, np.ndarray, np.ndarray]:
    """A system whose parameters are not independent once the rest is eliminated, and what is left of it then.

    Returns:
        The system; the Schur complement (p, p) and the right side (p,) of the parameters alone, dense.
    """
    rng = np.random.default_rng(seed)
    system, whole = random_system(3, 24, border)
    size = len(system.gradient)
    eliminated = np.linalg.solve(whole[:size, :size], np.column_stack((system.border.toarray(), system.gradient)))
    scale = np.sqrt(np.diag(system.corner - system.border.T @ eliminated[:, :-1]))
    mixed = rng.normal(size=(border, border))
    schur = (mixed @ mixed.T + 10.0 ** rng.uniform(-4.0, 0.0) * np.eye(border)) * scale * scale[:, None]
    slope = rng.normal(size=border) * 10.0 ** rng.uniform(-1.0, push, border) * np.sqrt(np.diag(schur))
    corner = schur + system.border.T @ eliminated[:, :-1]
    return (replace(system, corner=corner, corner_gradient=slope), schur, system.border.T @ eliminated[:, -1] - slope)


def random_bounds(schur: np.ndarray, seed: int) -> np.ndarray:
    """A third of the parameters without a bound, a third at it, the others some of their own units above it."""
    rng = np.random.default_rng(seed)
    room = rng.exponential(size=len(schur)) / np.sqrt(np.diag(schur))
    return -np.choose(rng.integers(3, size=len(schur)), [np.full(len(schur), np.inf), np.zeros(len(schur)), room])


def bounded_minimum(hessian: np.ndarray, right: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """The x >= lower with the least x H x / 2 - right x: of all choices of active bounds the one that is optimal."""
    unit = 1.0 / np.sqrt(np.diag(hessian))
    hessian, right, least = hessian * unit * unit[:, None], right * unit, lower / unit
    bounded, size = np.flatnonzero(np.isfinite(lower)), np.abs(right).max()
    for pattern in product([False, True], repeat=len(bounded)):
        held = np.zeros(len(lower), bool)
        held[bounded] = pattern
        x = np.where(held, least, 0.0)
        x[~held] = np.linalg.solve(hessian[np.ix_(~held, ~held)], (right - hessian @ x)[~held])
        if np.all(x >= least) and np.all((hessian @ x - right)[held] >= -1e-12 * size):
            return np.where(held, lower, unit * x)
    raise AssertionError("no choice of active bounds is optimal")


@pytest.mark.parametrize("push", [0.0, 2.0, 6.0])
@pytest.mark.parametrize("seed", range(10))
def test_a_bounded_step_is_the_least_within_its_bounds(seed, push):
    system, schur, right = coupled_system(7, seed, push)
    lower = random_bounds(schur, seed)
    w, x = solved(system, lower)
    expected, unit = bounded_minimum(schur, right, lower), 1.0 / np.sqrt(np.diag(schur))
    np.testing.assert_allclose(x / unit, expected / unit, rtol=1e-6, atol=1e-9 * np.abs(expected / unit).max())
    np.testing.assert_array_equal(x == lower, expected == lower)
    assert np.all(x >= lower)
    # The rest is where it is best, given the parameters.
    rest, root = np.linalg.solve(system.band.dense(), -system.gradient - system.border @ x), np.sqrt(system.band.main)
    np.testing.assert_allclose(w * root, rest * root, rtol=1e-6, atol=1e-9 * np.abs(w).max())


@pytest.mark.parametrize("seed", range(10))
def test_many_bounded_parameters(seed):
    """Too many to try every choice: the slope vanishes where x is free, and points outwards where it is held."""
    system, schur, right = coupled_system(50, seed, 3.0)
    lower = random_bounds(schur, seed)
    _, x = solved(system, lower)
    slope = (schur @ x - right) / np.sqrt(np.diag(schur))
    held, size = x == lower, np.abs(right / np.sqrt(np.diag(schur))).max()
    assert np.all(x >= lower)
    assert 5 < held.sum() < 45
    np.testing.assert_allclose(slope[~held], 0.0, atol=1e-8 * size)
    assert np.all(slope[held] >= -1e-8 * size)


def test_bounds_that_do_not_bind_change_nothing():
    system, _, _ = coupled_system(7, 0, 2.0)
    w, x = solved(system)
    for lower in (np.full(7, -np.inf), -2.0 * np.abs(x), np.where(x < 0, x, -0.0)):
        for given, expected in zip(solved(system, lower), (w, x), strict=True):
            np.testing.assert_array_equal(given, expected)


def test_a_damped_bounded_step_goes_downhill():
    system, schur, _ = coupled_system(7, 1, 2.0)
    lower = random_bounds(schur, 1)
    w, x = solved(system, lower, damping=0.1)
    assert np.all(x >= lower)
    assert np.any(x == lower)
    assert system.gradient @ w + system.corner_gradient @ x < 0


def test_parameters_that_are_held_stay_and_their_covariance_counts():
    random, (system, whole) = np.random.default_rng(0), random_system(2, 6, 2)
    root = random.standard_normal((2, 2)) / np.sqrt(np.diag(whole))[6:]
    covariance = root.T @ root + np.diag(1.0 / np.diag(whole)[6:])
    together = shared(system, held=covariance)
    factor = together.factor()
    weights, parameters = factor.step(together, np.full(2, -np.inf))
    assert np.array_equal(parameters, np.zeros(2))
    np.testing.assert_allclose(weights, -np.linalg.solve(whole[:6, :6], system.gradient), rtol=1e-8)
    np.testing.assert_allclose(factor.corner_covariance, covariance, rtol=1e-10)
    drawn = np.vstack(factored(system, held=covariance).draws(np.eye(8)))
    moved = -np.linalg.solve(whole[:6, :6], whole[:6, 6:])
    of_weights = np.linalg.inv(whole[:6, :6]) + moved @ covariance @ moved.T
    expected = np.block([[of_weights, moved @ covariance], [covariance @ moved.T, covariance]])
    unit = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(drawn @ drawn.T / unit / unit[:, None], expected / unit / unit[:, None], atol=1e-8)
