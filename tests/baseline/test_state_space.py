"""The chain as a state-space model: derivatives by finite differences, and a true motion leaves no residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_problems import NONLINEARITIES, measured, small_chain

from pinn_cli.baseline.state_space import NoiseLevels, StateSpace, Trajectory
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter


def problem(nonlinearity: str = "duffing", hidden: bool = False, hold: str = "exact") -> tuple[Problem, Trajectory]:
    """Everything measured without noise, or all but the force of DOF 1, and the true trajectory."""
    structure = small_chain(nonlinearity)
    measurements = measured(structure, hold, samples=513)
    record, truth = measurements.record, measurements.truth.response
    states = np.concatenate((truth.displacement, truth.velocity), axis=1)
    if hidden:
        record = without_force(record)
        rate = np.gradient(truth.force[:, :1], record.step, axis=0)
        states = np.concatenate((states, truth.force[:, :1], rate), axis=1)
    kinds = ["m", "c", "k", *NONLINEARITIES[nonlinearity][1]]
    uncertain = tuple(
        Parameter(kind, dof, value, 0.1 * abs(value))
        for kind, dof in zip(kinds, (1, 0, 1, 2), strict=False)
        for value in [float(structure.parameters[kind][dof])]
    )
    return Problem(structure, record, uncertain), Trajectory(states, np.zeros(len(uncertain)))


def without_force(record: Record) -> Record:
    force = record.force.copy()
    force[:, 0] = np.nan
    return replace(record, force=force)


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
@pytest.mark.parametrize("nonlinearity", NONLINEARITIES)
def test_the_true_motion_leaves_no_residual(nonlinearity: str, hold: str) -> None:
    posed, truth = problem(nonlinearity, hold=hold)
    space = StateSpace(posed)
    residuals, m = space.residuals(truth), len(space.sensors)
    assert np.abs(residuals[:, :m]).max() < 1e-12
    # Ends of the record aside, where a spline through the force knows less.
    moved = np.abs(residuals[5:-5, m:]).max(axis=0)
    assert np.all(moved < 1e-6 * np.abs(truth.states).max(axis=0))


@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize("nonlinearity", NONLINEARITIES)
def test_derivatives(nonlinearity: str, hidden: bool) -> None:
    posed, truth = problem(nonlinearity, hidden)
    space = StateSpace(posed)
    linearised, m = space.linearise(truth), len(space.sensors)
    inner = slice(100, 110)  # far from the start at rest, where a power of the speed has no second derivative

    def numerical(states: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        moved = (Trajectory(truth.states + sign * states, truth.parameters + sign * parameters) for sign in (1.0, -1.0))
        up, down = (space.residuals(trajectory) for trajectory in moved)
        change = (down - up) / 2.0
        # Moving a state moves the next state too, by itself: only what the model does is wanted.
        change[:-1, m:] += np.broadcast_to(states, truth.states.shape)[1:]
        return change[inner]

    nothing, small, part = np.zeros_like(truth.parameters), 1e-6, 0.03
    scale = np.abs(linearised.state[inner]).max(axis=(0, 2))
    for i, unit in enumerate(np.eye(space.size)):
        found, expected = linearised.state[inner, :, i], numerical(small * unit, nothing) / small
        np.testing.assert_allclose(found / scale, expected / scale, atol=2e-3)
    for j, unit in enumerate(np.eye(len(nothing))):
        found, expected = linearised.coefficient[inner, :, j], numerical(np.zeros(space.size), part * unit) / part
        largest = np.abs(expected).max(axis=0)
        close = np.abs(found - expected) <= 0.05 * largest + 1e-3 * largest.max() * space.step
        assert close.all()


def test_a_force_held_through_a_step_moves_it_as_the_disturbance_says() -> None:
    posed, truth = problem("linear", hold="zero_order")
    linearised = StateSpace(posed).linearise(truth)
    push = np.array([0.3, -0.2, 0.5])
    pushed = StateSpace(
        replace(posed, record=replace(posed.record, force=posed.record.force + push, unforced=np.zeros(3, bool)))
    )
    space = StateSpace(posed)
    m = len(space.sensors)
    expected = pushed.predicted(truth) - space.predicted(truth)
    np.testing.assert_allclose(linearised.disturbance[:-1, m:] @ push, expected, rtol=1e-5, atol=1e-12)
    felt = pushed.acceleration(truth) - space.acceleration(truth)
    rows = [row for row, sensor in enumerate(space.sensors) if sensor.quantity == "acceleration"]
    np.testing.assert_allclose(linearised.disturbance[:, rows] @ push, felt, rtol=1e-10)


def test_an_unmeasured_force_is_a_stationary_process() -> None:
    posed, truth = problem(hidden=True)
    space = StateSpace(posed)
    sigma = {q: np.ones(3) for q in ("displacement", "velocity", "acceleration")}
    model = space.model(space.linearise(truth), NoiseLevels(sigma, np.full(3, np.nan), 1.0))
    m, n = len(space.sensors), space.n
    carried = model.state[0, m + 2 * n :, 2 * n :]
    stationary = model.initial_covariance[2 * n :, 2 * n :]
    after = carried @ stationary @ carried.T + model.noise[m + 2 * n :, m + 2 * n :]
    np.testing.assert_allclose(after, stationary, rtol=1e-9, atol=1e-12 * stationary.max())
    np.linalg.cholesky(model.noise[m + 2 * n :, m + 2 * n :])
