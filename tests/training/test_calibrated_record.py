"""Records as their sensors turned out to be calibrated; filters and tilts that are known or found."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from lacking_records import K, calibrated_alike, high_passed, moved, posed, recorded
from one_record import by_spline

from pinn_cli.record.channel import Calibration, Channel
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.calibrated_record import as_calibrated, as_run, compared_record
from pinn_cli.training.estimate import Estimate, ParameterEstimate

TIME = 0.02 * np.arange(200)
FOUND = {"gain": 1.5, "offset": 0.3, "drift": -0.2, "delay": 0.05}


def motion(time: np.ndarray) -> np.ndarray:
    return np.sin(5.0 * time)


def channel(there: np.ndarray, noise: np.ndarray, quantity: str = "acceleration", weights=None) -> Channel:
    """What a sensor with the calibration `FOUND` shows; all four are unknown."""
    shown = FOUND["gain"] * (motion(TIME - FOUND["delay"]) + noise) + FOUND["offset"]
    shown += FOUND["drift"] * (TIME - TIME[there][0])
    unknown = {kind: Calibration(float(kind == "gain"), 1.0, unknown=True) for kind in FOUND}
    return Channel("a1", quantity, {0: 1.0} if weights is None else weights, TIME[there], shown[there], unknown)


def record_of(*channels: Channel, ground: bool = False) -> Record:
    nothing = np.full((200, 2), np.nan)
    acceleration = np.stack((np.zeros(200), motion(TIME)), axis=1)
    shaken = motion(TIME) if ground else None
    still = np.zeros((200, 2))
    record = Record(TIME, nothing, nothing, acceleration, still, np.ones(2, bool), calibrated=channels)
    return replace(record, ground_acceleration=shaken)


def estimate(found=FOUND) -> Estimate:
    same = np.stack((motion(TIME), motion(TIME)), axis=1)
    response = Response(TIME, same, same, same, 0.0 * same, motion(TIME))
    parameters = [
        ParameterEstimate(Parameter(kind, 0, label="a1"), value, 0.01, value, value) for kind, value in found.items()
    ]
    return Estimate(response, response, parameters, pd.DataFrame(), {})


def test_a_record_without_calibrated_channels_stays_as_it_is():
    record = record_of()
    assert as_calibrated(record, estimate({})) is record


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_columns_show_what_a_sensor_felt_by_what_was_found(share):
    rng = np.random.default_rng(0)
    noise, there = 0.1 * rng.normal(size=200), rng.random(200) <= share
    record = record_of(channel(there, noise))
    calibrated = as_calibrated(record, estimate())
    left = calibrated.acceleration[:, 0] - motion(TIME)
    seen = calibrated.column("acceleration", 0).there
    # What it felt at t - delay stands at the record's nearest time: half a step between two of them.
    assert seen.sum() == pytest.approx((there[3:]).sum(), abs=2)
    np.testing.assert_allclose(np.sort(left[seen]), np.sort(noise[there & (TIME >= 0.05)])[: seen.sum()], atol=1e-5)
    np.testing.assert_array_equal(left[~seen], 0.0)
    np.testing.assert_array_equal(calibrated.acceleration[:, 1], record.acceleration[:, 1])
    assert calibrated.column("acceleration", 1).there.all()


def test_a_sensor_of_several_dofs_fills_no_column():
    record = record_of(channel(np.ones(200, bool), np.zeros(200), "displacement", {0: 1.0, 1: -1.0}))
    calibrated = as_calibrated(record, estimate())
    assert np.isnan(calibrated.displacement).all()
    assert all(calibrated.column("displacement", dof).there.all() for dof in range(2))
    assert [felt.name for felt in calibrated.corrected] == ["displacement of sensor a1"]


def test_the_ground():
    there = np.arange(200) % 4 > 0
    record = record_of(channel(there, np.zeros(200), "ground_acceleration", {}), ground=True)
    calibrated = as_calibrated(record, estimate())
    np.testing.assert_allclose(calibrated.ground_acceleration, motion(TIME), atol=1e-5)
    assert calibrated.column("ground_acceleration", 0).there.sum() < 160


def test_a_tilt_that_is_known_is_no_error():
    """Its part of what the sensor shows is no acceleration, which its column is compared with."""
    response, everywhere = estimate().response, np.ones(200, bool)
    tilting = replace(
        channel(everywhere, np.zeros(200)), calibration={"tilt": Calibration(3.0)}, measured=4.0 * motion(TIME)
    )
    seen = compared_record(record_of(tilting), [], response).column("acceleration", 0)
    np.testing.assert_allclose(seen.measured, seen.of(response), atol=1e-5)


def test_a_training_says_itself_what_it_leaves():
    """Between the samples of an estimate there may be more than they show."""
    there, own = np.ones(200, bool), np.random.default_rng(1).normal(size=200)
    own[:20] = np.nan
    record = record_of(channel(there, np.zeros(200)))
    calibrated = as_calibrated(record, replace(estimate(), left={"a1": own}))
    seen = calibrated.column("acceleration", 0).there
    left = (calibrated.acceleration[:, 0] - motion(TIME))[seen]
    np.testing.assert_allclose(left, own[20:], atol=1e-12)


@pytest.mark.parametrize("quantity", ["acceleration", "force"])
def test_a_structure_that_runs_free_has_its_own_calibration(quantity):
    """The offset that goes with its parameters, where the motion goes with those of another story."""
    record = record_of(channel(np.ones(200, bool), np.zeros(200), quantity))
    if quantity == "force":
        record = replace(record, unforced=np.array([False, True]))
    own, motions = {"offset": 0.5, "gain": 1.0}, {"offset": 0.3, "gain": 1.0}
    found = estimate(own)
    told = replace(found, of_motion=estimate(motions).parameters, left={"a1": np.zeros(200)})
    shown = record.calibrated[0].measured
    run = as_run(record, told).histories(quantity)[:, 0]
    np.testing.assert_allclose(run, shown - own["offset"], atol=1e-12)
    np.testing.assert_array_equal(run, as_run(record, found).histories(quantity)[:, 0])
    of_motion = as_calibrated(record, replace(told, left={})).histories(quantity)[:, 0]
    np.testing.assert_allclose(of_motion, shown - motions["offset"], atol=1e-12)


CORNER = 0.5


def solved(record: Record) -> Estimate:
    return by_spline(posed(record))


def assert_right(estimate: Estimate, truth: Response) -> None:
    """Springs within four standard deviations, displacements in their bands."""
    for p in estimate.parameters:
        if p.kind == "k":
            assert abs(p.estimate - K[p.parameter.index]) < 4.0 * p.std < 0.01 * p.estimate
    inside = np.abs(estimate.response.displacement - truth.displacement) < 1.645 * estimate.std.displacement
    assert 0.75 < inside.mean() <= 1.0
    assert estimate.doubts == ()


@pytest.mark.parametrize(("ground", "order"), [(False, 1), (True, 2)])
@pytest.mark.slow
def test_behind_a_known_filter_displacements_are_in_their_bands(ground: bool, order: int):
    truth = moved(ground, 1, ())
    shown = dict(enumerate(high_passed(truth.acceleration, CORNER, order).T))
    record = calibrated_alike(recorded(truth, shown), order, high_pass=Calibration(CORNER))
    estimate = solved(record)
    assert_right(estimate, truth)
    left = as_calibrated(record, estimate).acceleration - estimate.response.acceleration
    assert (left.std(axis=0) < 0.02 * truth.acceleration.std(axis=0)).all()


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_an_unknown_corner_is_found(order: int):
    truth = moved(False, 1, ())
    shown = dict(enumerate(high_passed(truth.acceleration, CORNER, order).T))
    estimate = solved(calibrated_alike(recorded(truth, shown), order, high_pass=Calibration(0.1, 10.0, unknown=True)))
    assert_right(estimate, truth)
    for p in estimate.parameters:
        if p.kind == "high_pass":
            assert abs(p.estimate - CORNER) < 4.0 * p.std < 0.1


@pytest.mark.slow
def test_an_unknown_tilt_is_found():
    truth = moved(True, 1, ())
    record = recorded(truth, {2: truth.acceleration[:, 2] + 3.0 * truth.displacement[:, 2]})
    unknown = {"tilt": Calibration(0.0, 40.0, unknown=True)}
    tilting = Channel("a3", "acceleration", {2: 1.0}, record.time, record.acceleration[:, 2], unknown)
    record = replace(record, calibrated=(tilting,))
    estimate = solved(record)
    assert_right(estimate, truth)
    left = as_calibrated(record, estimate).acceleration[:, 2] - estimate.response.acceleration[:, 2]
    assert left.std() < 0.3 * (3.0 * truth.displacement[:, 2]).std()
    (tilt,) = (p for p in estimate.parameters if p.kind == "tilt")
    assert abs(tilt.estimate - 3.0) < 4.0 * tilt.std < 1.0


def test_what_a_filter_passes_is_what_its_equation_says():
    """A sinusoid, against the filter's transfer function, once how it began has died away."""
    time = np.arange(4000) / 50.0
    for order in (1, 2):
        channel = Channel(
            "x", "acceleration", {0: 1.0}, time, time, {"high_pass": Calibration(CORNER)}, filter_order=order
        )
        s, w = 2j * np.pi * 1.3, 2.0 * np.pi * CORNER
        gain = s**order / (s + w if order == 1 else s**2 + 2.0**0.5 * w * s + w**2)
        passed = channel.passed(time, np.sin(2.0 * np.pi * 1.3 * time))
        expected = (gain * np.exp(s * time)).imag
        np.testing.assert_allclose(passed[2000:], expected[2000:], atol=1e-3)
        began = np.linalg.lstsq(channel.decays(time), passed - expected)[0]
        np.testing.assert_allclose(passed - expected, channel.decays(time) @ began, atol=1e-3)
