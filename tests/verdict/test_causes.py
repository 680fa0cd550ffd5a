"""What is wrong with a record or a structure is named by the structure that is right: prescribed, unknown, shaken."""

from dataclasses import replace

import numpy as np
import pytest
from frame_records import altered

from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.verdict.causes import causes


@pytest.fixture
def problem(frame, frame_record):
    """A frame whose stiffnesses are right."""
    return Problem(frame, frame_record, ())


@pytest.fixture
def from_afar(frame, frame_record):
    """The same whose stiffnesses are unknown, and started 5 times too low."""
    unknown = tuple(Parameter("k", dof, 3.0, 30.0, unknown=True, positive=True) for dof in range(3))
    return Problem(frame.with_parameters(k=frame.parameters["k"] / 5.0), frame_record, unknown)


def found(problem, excused=()):
    return causes(problem, problem.structure, problem.structure, excused)


def test_a_good_record_has_no_cause(problem):
    assert found(problem) == []


RUINED = {
    "unit": lambda x: x / 9.80665,
    "gain": lambda x: 3.0 * x,
    "sign": lambda x: -x,
    "delay": lambda x: np.roll(x, 3),
}


@pytest.mark.parametrize("kind", RUINED)
def test_a_ruined_channel(problem, kind):
    (cause,) = found(replace(problem, record=altered(problem.record, 3, RUINED[kind])))
    assert (cause.kind, cause.suspect) == (kind, "acceleration of DOF 3")


@pytest.mark.slow
def test_causes_beside_stiffnesses_that_are_unknown(from_afar):
    assert found(from_afar) == []
    (cause,) = found(replace(from_afar, record=altered(from_afar.record, 3, RUINED["sign"])))
    assert (cause.kind, cause.suspect) == ("sign", "acceleration of DOF 3")
    m = from_afar.structure.parameters["m"].clone()
    m[1] *= 0.5
    (cause,) = found(replace(from_afar, structure=from_afar.structure.with_parameters(m=m)))
    assert (cause.kind, cause.suspect) == ("mass", "m_2")


def test_an_excused_channel_is_not_asked(problem):
    spoilt = replace(problem, record=altered(problem.record, 3, RUINED["sign"]))
    assert all(cause.suspect != "acceleration of DOF 3" for cause in found(spoilt, ["acceleration of DOF 3"]))


def test_a_sensor_that_is_still_and_excused_hides_no_other_one(problem):
    spoilt = altered(altered(problem.record, 3, RUINED["sign"]), 2, lambda x: 0.0 * x)
    (cause,) = found(replace(problem, record=spoilt), ["acceleration of DOF 2"])
    assert (cause.kind, cause.suspect) == ("sign", "acceleration of DOF 3")


def test_exchanged_sensors(problem):
    acceleration = problem.record.acceleration[:, [2, 1, 0]]
    (cause,) = found(replace(problem, record=replace(problem.record, acceleration=acceleration)))
    assert (cause.kind, cause.suspect) == ("swap", "acceleration of DOFs 1 and 3")


@pytest.mark.slow
def test_exchanged_sensors_that_led_the_estimate_astray(from_afar):
    k = from_afar.structure.parameters["k"]
    astray = from_afar.structure.with_parameters(k=k * k.new_tensor([1e-3, 50.0, 200.0]))
    record = replace(from_afar.record, acceleration=from_afar.record.acceleration[:, [2, 1, 0]])
    (cause,) = causes(replace(from_afar, record=record), from_afar.structure, astray)
    assert (cause.kind, cause.suspect) == ("swap", "acceleration of DOFs 1 and 3")


def test_a_sign_that_led_the_search_and_its_start_astray(from_afar):
    k = from_afar.structure.parameters["k"]
    astray = from_afar.structure.with_parameters(k=5.0 * k * k.new_tensor([50.0, 0.05, 0.02]))
    spoilt = replace(from_afar, structure=astray, record=altered(from_afar.record, 1, RUINED["sign"]))
    (cause,) = found(spoilt)
    assert (cause.kind, cause.suspect) == ("sign", "acceleration of DOF 1")


@pytest.mark.parametrize(("dof", "factor"), [(1, 5.0), (2, 0.5)])
def test_a_wrong_mass(problem, dof, factor):
    m = problem.structure.parameters["m"].clone()
    m[dof - 1] *= factor
    (cause,) = found(replace(problem, structure=problem.structure.with_parameters(m=m)))
    assert (cause.kind, cause.suspect) == ("mass", f"m_{dof}")
    assert abs(float(cause.text.split()[3]) - 10.0) < 0.5


def test_wrong_dampers(problem):
    wrong = problem.structure.with_parameters(c=10.0 * problem.structure.parameters["c"])
    (cause,) = found(replace(problem, structure=wrong))
    assert cause.kind == "damping"


@pytest.mark.parametrize(("scale", "told"), [(1e3, "milliseconds"), (1 / 60, "minutes")])
def test_a_time_axis_in_another_unit(frame, frame_record, scale, told):
    (cause,) = found(Problem(frame, replace(frame_record, time=frame_record.time * scale), ()))
    assert (cause.kind, cause.word) == ("time_unit", "failed")
    assert told in cause.text


def test_a_structure_that_is_wrong_in_many_ways_has_no_one_cause(frame, frame_record):
    wrong = frame.with_parameters(k=frame.parameters["k"] * frame.parameters["k"].new_tensor([0.3, 3.0, 0.2]))
    assert found(Problem(wrong, frame_record, ())) == []


def test_a_structure_that_is_released_has_no_spectra_to_compare(problem):
    record = replace(problem.record, force=np.zeros_like(problem.record.force))
    assert found(replace(problem, record=record)) == []
