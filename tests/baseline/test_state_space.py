"""A problem as a state-space model: its steps, derivatives, sensors in doubt and missing samples."""

from dataclasses import replace

import numpy as np
import pytest
from calls import refusal
from hypothesis import HealthCheck, assume, given, settings
from random_problems import generators, problems
from small_problems import NONLINEARITIES, measured, relative_error, small_chain

from pinn_cli.baseline.kalman_smoother import KalmanSmoother
from pinn_cli.baseline.state_space import StateSpace, Trajectory
from pinn_cli.record.channel import Calibration, Channel, unknown_calibration
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.steps import has_stiff_law, substeps_needed
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.training.estimate import RunContext

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


GAIN, OFFSET, LOAD_GAIN, LOAD_OFFSET = 1.3, 0.4, 0.8, 0.2


def made(snr_db: float | None = None) -> Measurements:
    return measured(small_chain("linear"), snr_db=snr_db, duration=24.0, samples=513)


def unknown(time: np.ndarray, shown: np.ndarray, *kinds: str) -> dict[str, Calibration]:
    return {kind: unknown_calibration(kind, time, shown) for kind in kinds}


def in_doubt(record: Record, kinds: tuple[str, ...] = ("gain", "offset")) -> Record:
    """Half of the samples of an accelerometer, and the load cell, with other gains and offsets."""
    time = record.time
    there = np.random.default_rng(0).random(len(time)) < 0.5
    shown = GAIN * record.acceleration[:, 1] + OFFSET
    load = LOAD_GAIN * record.force[:, 0] + LOAD_OFFSET
    calibrated = (
        Channel("a2", "acceleration", {1: 1.0}, time[there], shown[there], unknown(time, shown, *kinds)),
        Channel("drift", "displacement", {2: 1.0, 0: -1.0}, time, record.displacement @ [-1.0, 0.0, 1.0]),
        Channel("f", "force", {0: 1.0}, time, load, unknown(time, load, *kinds)),
    )
    acceleration, force, nothing = record.acceleration.copy(), record.force.copy(), np.full(record.force.shape, np.nan)
    acceleration[:, 1], force[:, 0] = calibrated[0].history(time), calibrated[2].history(time)
    return replace(
        record, acceleration=acceleration, force=force, displacement=nothing, velocity=nothing, calibrated=calibrated
    )


def test_a_sample_that_is_missing_tells_nothing() -> None:
    record = in_doubt(made().record)
    problem = Problem(small_chain("linear"), record, sensor_parameters(record))
    space = StateSpace(problem)
    row = [sensor.channel.key for sensor in space.sensors].index("a2")
    gone = ~space.present[:, row]
    assert 0.4 < gone.mean() < 0.6
    linearised = space.linearise(space.start())
    for rows in (linearised.rows, linearised.residuals):
        assert not rows[gone, row].any()
        assert rows[~gone, row].any()


@pytest.mark.slow
def test_gains_and_offsets_are_found_beside_the_motion() -> None:
    measurements = made(snr_db=40.0)
    record = in_doubt(measurements.record)
    problem = SparseRecovery().pose(small_chain("linear"), [record]).alone
    smoother = KalmanSmoother()
    smoother.check(problem)
    estimate = smoother.solve(JointProblem.of(problem), RunContext())
    true = {"gain_a2": GAIN, "offset_a2": OFFSET, "gain_f": LOAD_GAIN, "offset_f": LOAD_OFFSET}
    found = {p.name: p for p in estimate.parameters}
    for name, value in true.items():
        assert abs(found[name].estimate - value) < 4.0 * found[name].std, name
    assert found["gain_a2"].std < 0.02
    assert found["gain_f"].std < 0.02
    truth = measurements.truth.response
    assert relative_error(estimate.response.acceleration, truth.acceleration) < 0.05
    assert relative_error(estimate.response.force[:, 0], truth.force[:, 0]) < 0.1


def test_a_delay_that_is_known_is_taken_out() -> None:
    record = made().record
    time, late = record.time, {"delay": Calibration(2.4 * record.step)}
    shown = np.interp(time - 2.4 * record.step, time, record.acceleration[:, 1])
    channel = Channel("a2", "acceleration", {1: 1.0}, time, shown, late)
    channel = StateSpace(Problem(small_chain("linear"), replace(record, calibrated=(channel,)))).sensors[0]
    seen = channel.present & (np.arange(len(time)) > 5)
    assert relative_error(channel.shown[seen], record.acceleration[seen, 1]) < 0.02
    assert not channel.present[-1]


def test_what_it_has_no_rows_for_is_refused_in_one_line() -> None:
    record = made().record
    there = np.random.default_rng(0).random(len(record.time)) < 0.5
    plain = Channel("x", "acceleration", {1: 1.0}, record.time, record.acceleration[:, 1])
    aside = Channel(
        "x", "acceleration", {0: 1.0}, record.time[there] + 0.3 * record.step, record.acceleration[there, 0]
    )
    for channel, expected in (
        (replace(plain, calibration={"delay": Calibration(0.0, 0.1, unknown=True)}), "none where a delay is in doubt"),
        (replace(plain, filter_order=1), "none where a sensor is behind a filter"),
        (aside, "between the record's times"),
    ):
        problem = Problem(small_chain("linear"), replace(record, calibrated=(channel,)))
        said = refusal(KalmanSmoother().check, problem)
        assert said.startswith("baseline=kalman_smoother: must be none where")
        assert expected in said
