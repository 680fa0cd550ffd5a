"""A frame on moving ground or in the wind: faults of sensors, and resonances that they show."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from ambient_records import AmbientRecord, ambient_record
from storeys import K, M
from storeys import record as storeys_record

from pinn_cli.record.channels import channels
from pinn_cli.record.excitation.ground_motion import GroundMotion
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.response import Response
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.noise_model import FoundNoise
from pinn_cli.verdict.causes import causes
from pinn_cli.verdict.channel_faults import channel_faults, record_faults
from pinn_cli.verdict.input_findings import resonance_findings, sampling_findings
from pinn_cli.verdict.judge import judge
from pinn_cli.verdict.prediction import predicted

LINEAR = build_chain(3, Linear(), m=[2e3, 2e3, 1.5e3], c=6e3, k=[8e5, 7.2e5, 5.6e5])
DUFFING = build_chain(3, Duffing(), m=[2e3, 2e3, 1.5e3], c=6e3, k=[8e5, 7.2e5, 5.6e5], kappa=2e8)
REST = (LINEAR, "relative"), (DUFFING, "absolute")
SPAN = {"duration": 30.0, "samples": 1501}


@cache
def measured(structure=LINEAR, frame="absolute", snr_db=30.0) -> Measurements:
    motion = GroundMotion(3, **SPAN, highest=10.0, high_pass=0.4)
    found = Simulated(motion, Simulation(**SPAN), Noise(snr_db), frame).measure(structure)
    return Measurements(found.record.keep({"acceleration": (1, 2, 3)}), found.truth)


@pytest.fixture(scope="module")
def record():
    return measured().record


def faults(structure, record):
    return channel_faults(predicted(structure, record))


@pytest.mark.parametrize(
    ("structure", "frame"),
    [(LINEAR, "absolute"), (DUFFING, "relative"), *(pytest.param(*x, marks=pytest.mark.slow) for x in REST)],
)
def test_a_good_record_has_no_fault_in_its_own_frame_and_one_in_the_other(structure, frame):
    record = measured(structure, frame).record
    assert faults(structure, record) == []
    assert record_faults(record) == []
    other = replace(record, frame="relative" if frame == "absolute" else "absolute")
    prediction = predicted(structure, other)
    left = record.acceleration - prediction.response.acceleration[: len(record.time)]
    assert np.mean(left**2) > 0.05 * np.mean(record.acceleration**2)


@pytest.mark.parametrize(
    ("influence", "frame"), [(None, "absolute"), (np.array([1.0, 0.5, 0.0]), "relative")], ids=["all", "in_part"]
)
def test_the_prediction_of_a_linear_frame_is_its_response(influence, frame):
    structure = LINEAR if influence is None else replace(LINEAR, influence=influence)
    found = measured(structure, frame, snr_db=None)
    response, truth = predicted(structure, found.record).response, found.truth.response
    later = slice(1000, 1500)  # what is left of the free decays has died out
    for quantity in ("displacement", "acceleration"):
        given, expected = getattr(response, quantity)[later], getattr(truth, quantity)[later]
        assert np.max(np.abs(given - expected)) < 0.01 * np.max(np.abs(getattr(truth, quantity)))


@pytest.mark.parametrize(
    ("kind", "change", "told"),
    [
        ("unit", lambda x: x / 9.80665, "check the unit of data.ground_acceleration"),
        ("gain", lambda x: 1.15 * x, "check the calibration of data.ground_acceleration"),
        ("sign", lambda x: -x, "multiply it by -1"),
        ("delay", lambda x: np.roll(x, 3), "s late; shift its column in time"),
    ],
)
def test_a_ruined_ground_sensor_is_named(record, kind, change, told):
    (found,) = faults(LINEAR, replace(record, ground_acceleration=change(record.ground_acceleration)))
    assert (found.kind, found.suspect) == (kind, "ground acceleration")
    assert told in found.text


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("clip", lambda x: np.clip(x, -1.5 * x.std(), 1.5 * x.std())),
        ("dropout", lambda x: np.where(np.arange(len(x)) // 100 == 3, 0.0, x)),
        ("offset", lambda x: x + 0.3 * x.std()),
        ("still", lambda x: 0.0 * x),
    ],
)
def test_the_ground_s_channel_is_looked_at_by_itself(record, kind, change):
    (found,) = record_faults(replace(record, ground_acceleration=change(record.ground_acceleration)))
    assert (found.kind, found.suspect) == (kind, "ground acceleration")


def test_a_ruined_accelerometer_and_a_wrong_mass_are_found_under_an_earthquake(record):
    (found,) = faults(LINEAR, replace(record, acceleration=record.acceleration * [1.0, 1.2, 1.0]))
    assert (found.kind, found.suspect) == ("gain", "acceleration of DOF 2")
    assert "under the measured ground acceleration" in found.text
    wrong = LINEAR.with_parameters(m=LINEAR.parameters["m"] * LINEAR.parameters["m"].new_tensor([1.0, 3.0, 1.0]))
    (found,) = causes(Problem(wrong, record, ()), wrong, wrong)
    assert found.suspect == "m_2"
    assert "0.33" in found.text
    assert causes(Problem(LINEAR, record, ()), LINEAR, LINEAR) == []


def estimate(found: Measurements, discrepancy: float = np.nan, **sensors) -> Estimate:
    """The truth itself, with levels of noise."""
    std = Response(found.record.time, *(np.full((SPAN["samples"], 3), 1e-5) for _ in range(4)))
    noise = FoundNoise({quantity: np.array(levels) for quantity, levels in sensors.items()}, discrepancy)
    return Estimate(found.truth.response, std, [], pd.DataFrame(), {"stop_reason": "converged"}, noise=noise)


def test_a_right_estimate_is_sound_and_a_large_discrepancy_is_told():
    found = measured()
    left = found.record.acceleration - found.truth.response.acceleration
    noise = np.std(left, axis=0).tolist()
    problem = Problem(LINEAR, found.record, ())
    sound = estimate(found, 1.0, acceleration=noise, ground_acceleration=[0.02])
    assert judge(problem, sound).word == "sound"
    (ground,) = channels(found.record, ["ground_acceleration"])
    assert sound.noise.of(ground) == 0.02
    assert np.isnan(estimate(found).noise.of(ground))
    loud = estimate(found, 0.4 * 2e3 * 0.6, acceleration=noise)
    (reason,) = judge(problem, loud).reasons
    assert "of what acts" in reason.text


# Of a sensor, m/s^2.
QUIET, LOUD = 1e-3, 1e3


def asked(record: Record, noise: float = QUIET) -> list[str]:
    given = estimate(measured(), acceleration=[np.nan, np.nan, noise])
    return [finding.text for finding in sampling_findings(Problem(LINEAR, record), given, LINEAR)]


@pytest.fixture(scope="module")
def rare() -> Record:
    """A ground whose samples still have content at the Nyquist frequency."""
    record = measured().record
    white = np.random.default_rng(0).standard_normal(len(record.time) + 1)
    return replace(record, ground_acceleration=np.convolve(white, [0.5, 0.5], "valid"), assumed=True)


def test_it_is_asked_where_it_matters_and_nobody_said(rare):
    (text,) = asked(rare)
    assert "25 Hz" in text
    assert "data.intersample" in text
    assert asked(replace(rare, assumed=False)) == []
    assert asked(rare, LOUD) == []
    assert asked(replace(measured().record, assumed=True)) == []


def forced(snr_db: float, low_pass: int, assumed: bool = True) -> Record:
    """The shaken frame's record with a force on its roof: white, or its mean over so many samples, and noise."""
    record, rng = measured().record, np.random.default_rng(1)
    force = np.convolve(
        rng.standard_normal(len(record.time) + low_pass - 1), np.full(low_pass, 1e3 / low_pass), "valid"
    )
    noise = 10.0 ** (-snr_db / 20.0) * force.std() * rng.standard_normal(len(force))
    forces = np.zeros_like(record.force)
    forces[:, 2] = force + noise
    unforced = np.array([True, True, False])
    return replace(record, ground_acceleration=None, force=forces, unforced=unforced, assumed=assumed)


def test_a_force_up_to_the_nyquist_frequency_is_asked_about():
    (text,) = asked(forced(40.0, low_pass=1))
    assert "the force of DOF 3 has content up to the Nyquist frequency, 25 Hz" in text
    assert "data.intersample=" in text
    # But not of a poor load cell, or where it was said.
    assert asked(forced(10.0, low_pass=6)) == []
    assert asked(forced(40.0, low_pass=1, assumed=False)) == []
    # Nor of a hammer whose blow comes early: the noise after it is none of its content.
    record, rng = forced(40.0, low_pass=1), np.random.default_rng(2)
    blow = 1e3 * np.exp(-0.5 * (np.arange(len(record.time)) / 2.0 - 5.0) ** 2)
    blows = np.zeros_like(record.force)
    blows[:, 2] = blow + 0.1 * blow.std() * rng.standard_normal(len(blow))
    assert asked(replace(record, force=blows)) == []


@pytest.fixture(scope="module", params=[(4.0, None, 0), (1.5, 1.0, 2)], ids=["flat", "wind"])
def made(request) -> AmbientRecord:
    first_frequency, corner, seed = request.param
    return ambient_record(first_frequency, 50.0, 60.0, 20.0, corner, floors=4, seed=seed)


def words(structure: Structure, record) -> list[str]:
    problem = SparseRecovery().pose(structure, [record]).alone
    return [finding.word for finding in resonance_findings(problem, structure)]


@pytest.mark.parametrize(("stiffer", "told"), [(1.0, ""), (0.6, "failed"), (1e-5, "failed")])
def test_a_structure_in_the_wind_has_the_resonances_that_the_sensors_show(made, stiffer, told):
    structure = made.structure.with_parameters(k=stiffer * made.structure.parameters["k"])
    assert words(structure, made.record) == [told] * bool(told)


@pytest.mark.parametrize(("stiffer", "told"), [(1.0, ""), (0.6, "questionable"), (1e-5, "failed")])
def test_and_one_under_a_measured_force_those_of_the_response_to_it(stiffer, told):
    structure = build_chain(len(K), Linear(), m=M, c=0.002 * K, k=stiffer * K)
    assert words(structure, storeys_record(0).record) == [told] * bool(told)
