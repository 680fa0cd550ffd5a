"""Sensors in doubt and missing samples in the smoother: derivatives, what is skipped, refused and found."""

from dataclasses import replace

import numpy as np
import pytest
from small_problems import measured, relative_error, small_chain

from pinn_cli.baseline.kalman_smoother import KalmanSmoother
from pinn_cli.baseline.state_space import StateSpace, check_channels
from pinn_cli.record.channel import Calibration, Channel, unknown_calibration
from pinn_cli.record.record import Measurements, Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.settings.errors import InputError
from pinn_cli.training.estimate import RunContext

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


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"calibration": {"delay": Calibration(0.0, 0.1, unknown=True)}}, "none where a delay is in doubt"),
        ({"filter_order": 1}, "none where a sensor is behind a filter"),
    ],
)
def test_what_it_has_no_rows_for_is_refused_in_one_line(change: dict, expected: str) -> None:
    record = made().record
    channel = replace(Channel("x", "acceleration", {1: 1.0}, record.time, record.acceleration[:, 1]), **change)
    with pytest.raises(InputError, match="baseline=kalman_smoother: must be none where") as error:
        check_channels(replace(record, calibrated=(channel,)), "kalman_smoother")
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_samples_that_stand_nowhere_are_refused() -> None:
    record = made().record
    there = np.random.default_rng(0).random(len(record.time)) < 0.5
    time = record.time[there] + 0.3 * record.step
    channel = Channel("x", "acceleration", {0: 1.0}, time, record.acceleration[there, 0])
    with pytest.raises(InputError, match="between the record's times"):
        check_channels(replace(record, calibrated=(channel,)), "kalman_smoother")
