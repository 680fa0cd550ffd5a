"""L-BFGS and self-scaled Broyden on functions whose minimum is known."""

from __future__ import annotations

import math

import pytest
import scipy.optimize
import torch
from plain_objectives import PlainObjective, minimise, quadratic, rosenbrock

from pinn_cli.training.gradient.inverse_hessian import scaling, update
from pinn_cli.training.gradient.lbfgs import LbfgsSteps
from pinn_cli.training.gradient.optimiser import GRADIENT_VANISHED, NOTHING_LOWER, Optimiser
from pinn_cli.training.gradient.ssbroyden import SsBroydenSteps

METHODS = ("lbfgs", "ssbroyden")


def optimiser(name: str, objective: PlainObjective, tolerance: float = 1e-10) -> Optimiser:
    return LbfgsSteps(objective, 20, tolerance) if name == "lbfgs" else SsBroydenSteps(tolerance)


@pytest.mark.parametrize("name", METHODS)
def test_rosenbrocks_valley_is_walked_as_fast_as_by_scipy(name):
    start = torch.tensor([-1.2, 1.0] * 3, dtype=torch.float64)
    objective = PlainObjective(rosenbrock, start)
    iterations, reason = minimise(optimiser(name, objective), objective, 500)
    assert reason == GRADIENT_VANISHED
    assert torch.allclose(objective.x, torch.ones(6, dtype=torch.float64), atol=1e-9)
    theirs = scipy.optimize.minimize(
        scipy.optimize.rosen, start.numpy(), jac=scipy.optimize.rosen_der, method="BFGS", options={"gtol": 1e-10}
    )
    assert iterations <= 1.5 * theirs.nit


@pytest.mark.parametrize("name", METHODS)
def test_a_quadratic_ends_in_a_few_times_its_dimension(name):
    function, bottom = quadratic(12, 1e3)
    objective = PlainObjective(function, torch.zeros(12, dtype=torch.float64))
    iterations, reason = minimise(optimiser(name, objective), objective, 200)
    assert reason == GRADIENT_VANISHED
    assert iterations <= (100 if name == "lbfgs" else 60)
    torch.testing.assert_close(objective.x.detach(), bottom, atol=1e-9, rtol=0.0)


@pytest.mark.parametrize("name", METHODS)
def test_tiny_values_are_no_reason_to_stop(name):
    function, bottom = quadratic(6, 100.0)
    objective = PlainObjective(lambda x: 1e-12 * function(x), torch.zeros(6, dtype=torch.float64))
    minimise(optimiser(name, objective, tolerance=1e-20), objective, 100)
    torch.testing.assert_close(objective.x.detach(), bottom, atol=1e-6, rtol=0.0)


@pytest.mark.parametrize("name", METHODS)
def test_at_the_limit_of_digits_the_search_finds_nothing_lower(name):
    objective = PlainObjective(lambda x: 1.0 + rosenbrock(x), torch.tensor([-1.2, 1.0], dtype=torch.float64))
    iterations, reason = minimise(optimiser(name, objective, tolerance=0.0), objective, 400)
    assert reason in (NOTHING_LOWER, GRADIENT_VANISHED)
    assert iterations < 400
    assert torch.allclose(objective.x, torch.ones(2, dtype=torch.float64), atol=1e-5)


@pytest.mark.parametrize("name", METHODS)
def test_bounds_are_kept_and_the_bounded_minimum_is_found(name):
    # Within x_2 >= 2 Rosenbrock's function is least at (1.4, 2), within x_2 >= -1 at (1, 1).
    for lower, expected in ((2.0, math.nan), (-1.0, 1.0)):
        objective = PlainObjective(rosenbrock, torch.tensor([-1.2, 4.0], dtype=torch.float64), (lower,))
        _, reason = minimise(optimiser(name, objective, tolerance=1e-8), objective, 300)
        assert reason
        assert min(float(x[1]) for x in objective.visited) >= lower
        bounds = [(None, None), (lower, None)]
        theirs = scipy.optimize.minimize(
            scipy.optimize.rosen, [-1.2, 4.0], jac=scipy.optimize.rosen_der, method="L-BFGS-B", bounds=bounds
        )
        assert float(rosenbrock(objective.x.detach())) <= theirs.fun + 1e-6
        if not math.isnan(expected):
            assert float(objective.x.detach()[1]) == pytest.approx(expected, abs=1e-6)
        else:
            assert float(objective.x.detach()[1]) == lower


@pytest.mark.parametrize("name", METHODS)
def test_going_on_from_a_state_changes_no_bit(name):
    start = torch.tensor([-1.2, 1.0, 0.3, 2.0], dtype=torch.float64)
    whole = PlainObjective(rosenbrock, start)
    method = optimiser(name, whole)
    minimise(method, whole, 9)
    rest = PlainObjective(rosenbrock, whole.x.detach())
    resumed = optimiser(name, rest)
    resumed.load_state_dict(method.state_dict())
    minimise(method, whole, 7)
    minimise(resumed, rest, 7)
    assert torch.equal(whole.x, rest.x)


def test_the_inverse_hessian_maps_the_gradients_change_to_the_step_and_stays_positive():
    generator = torch.Generator().manual_seed(3)
    root = torch.randn(8, 8, generator=generator, dtype=torch.float64)
    hessian = root @ root.T + 0.1 * torch.eye(8, dtype=torch.float64)
    inverse = torch.eye(8, dtype=torch.float64)
    for _ in range(20):
        s, gradient = torch.randn(2, 8, generator=generator, dtype=torch.float64)
        y = hessian @ s
        applied = update(inverse, s, y, float(s @ torch.linalg.solve(inverse, s)), gradient)
        torch.testing.assert_close(inverse @ y, s)
        torch.testing.assert_close(applied, inverse @ gradient)
        torch.testing.assert_close(inverse, inverse.T)
        assert float(torch.linalg.eigvalsh(inverse)[0]) > 0


def test_without_positive_curvature_nothing_is_learned():
    inverse = torch.eye(2, dtype=torch.float64)
    s = torch.tensor([1.0, 0.0], dtype=torch.float64)
    assert update(inverse, s, -s, 1.0, s) is None
    assert torch.equal(inverse, torch.eye(2, dtype=torch.float64))


def test_scaling_shrinks_an_inverse_hessian_that_is_too_small_and_leaves_a_good_one():
    assert scaling(1.0, 1.0, 10) == (1.0, 1.0)
    tau, _ = scaling(4.0, 2.0, 10)
    assert tau <= 0.25
    for b, h in ((0.1, 20.0), (3.0, 0.7), (50.0, 50.0), (1e-3, 1e6)):
        tau, phi = scaling(b, h, 100)
        assert 0 < tau <= 1.0
        assert 1.0 + phi * (b * h - 1.0) > 0  # positive definite (Al-Baali 2014)
