"""A problem as a state-space model: derivatives by finite differences, and a true motion leaves no residual."""

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from random_problems import generators, problems
from small_problems import NONLINEARITIES, measured, small_chain

from pinn_cli.baseline.state_space import StateSpace, Trajectory
from pinn_cli.record.steps import has_stiff_law, substeps_needed
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem

FIXED = settings(derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
@pytest.mark.parametrize("nonlinearity", NONLINEARITIES)
def test_the_true_motion_leaves_no_residual(nonlinearity: str, hold: str) -> None:
    structure = small_chain(nonlinearity)
    measurements = measured(structure, hold, samples=513)
    truth = measurements.truth.response
    states = np.concatenate((truth.displacement, truth.velocity), axis=1)
    space = StateSpace(Problem(structure, measurements.record))
    residuals, m = space.residuals(Trajectory(states, np.zeros(0))), len(space.sensors)
    assert np.abs(residuals[:, :m]).max() < 1e-12
    # Ends of the record aside, where a spline through the force knows less.
    moved = np.abs(residuals[5:-5, m:]).max(axis=0)
    assert np.all(moved < 1e-6 * np.abs(states).max(axis=0))


@pytest.mark.parametrize("examples", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_rows_are_the_derivatives_of_residuals_for_any_problem(examples: int) -> None:
    drawn = given(problems(plain=False) | problems(plain=True), generators())(check_rows)
    settings(FIXED, max_examples=examples)(drawn)()


def check_rows(drawn: JointProblem, rng: np.random.Generator) -> None:
    problem = drawn.first
    assume(not problem.inputs.filters and not has_stiff_law(problem.structure))
    assume(substeps_needed(problem.structure, problem.record.step) < 10)
    space = StateSpace(problem)
    space.roughly_between = space.between  # derivatives as exact as the steps
    states, p = 0.1 * rng.normal(size=(len(problem.record.time), space.size)), len(problem.uncertain)
    at = Trajectory(states, 0.1 * rng.normal(size=p))
    linearised, m, small = space.linearise(at), len(space.sensors), 1e-5

    def slope(state: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        steps = (small, -small)
        moved = [Trajectory(states + step * state, at.parameters + step * parameters) for step in steps]
        up, down = map(space.residuals, moved)
        change = (down - up) / (2.0 * small)
        # Moving a state moves the next state too, by itself: only what the model does is wanted.
        change[:, m:] += state
        return change[:-1]

    expected = [slope(unit, np.zeros(p)) for unit in np.eye(space.size)]
    expected += [slope(np.zeros(space.size), unit) for unit in np.eye(p)]
    found = np.delete(linearised.rows[:-1], space.size + np.arange(space.dynamics.size), axis=2)
    scale = np.abs(found).max(axis=(0, 2), keepdims=True)
    assert np.all(np.abs(found - np.stack(expected, axis=2)) <= 1e-4 * np.abs(found) + 1e-5 * scale)


def test_a_force_held_through_a_step_moves_it_as_the_disturbance_says() -> None:
    structure = small_chain("linear")
    record = measured(structure, "zero_order", samples=513).record
    space = StateSpace(Problem(structure, record))
    at = Trajectory(np.random.default_rng(0).normal(size=(len(record.time), space.size)), np.zeros(0))
    linearised, before, m = space.linearise(at), space.residuals(at), len(space.sensors)
    push = np.array([0.3, -0.2, 0.5])
    space.force, space.between = space.force + push, space.between + push
    change = before - space.residuals(at)
    expected = linearised.rows[:, :, space.size : space.size + 3] @ push
    np.testing.assert_allclose(expected, change, rtol=1e-5, atol=1e-10 * np.abs(change[:, :m]).max())
