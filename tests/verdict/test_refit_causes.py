"""With every stiffness unknown and started 5 times too low: the stiffnesses come out, and so does what is ruined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from frame_records import altered

from pinn_cli.scheme.problem import Problem
from pinn_cli.system.chain import chain_of
from pinn_cli.system.connection import Duffing
from pinn_cli.system.parameters import Parameter
from pinn_cli.verdict.refit import refitted
from pinn_cli.verdict.refit_causes import refit_causes

FREE = [Parameter("k", dof) for dof in range(3)]


@pytest.fixture
def problem(frame, frame_record):
    unknown = tuple(Parameter("k", dof, 3.0, 30.0, unknown=True, positive=True) for dof in range(3))
    return Problem(frame.with_parameters(k=frame.parameters["k"] / 5.0), frame_record, unknown)


@pytest.mark.parametrize("levels", [True, False])
def test_stiffnesses_from_spectra_and_a_few_steps(problem, levels):
    fitted = refitted(problem.structure, problem.record, FREE, (), levels)
    assert fitted is not None
    assert fitted.parameters["k"].numpy() == pytest.approx(15.0, rel=0.01)


def test_a_good_record_has_no_cause(problem):
    assert refit_causes(problem, ()) == []


RUINED = {
    "unit": lambda x: x / 9.80665,
    "gain": lambda x: 1.15 * x,
    "sign": lambda x: -x,
    "delay": lambda x: np.roll(x, 3),
}


@pytest.mark.parametrize("kind", RUINED)
def test_a_ruined_channel(problem, kind):
    (found,) = refit_causes(replace(problem, record=altered(problem.record, 3, RUINED[kind])), ())
    assert (found.kind, found.suspect) == (kind, "acceleration of DOF 3")


def test_exchanged_sensors(problem):
    acceleration = problem.record.acceleration[:, [2, 1, 0]]
    (found,) = refit_causes(replace(problem, record=replace(problem.record, acceleration=acceleration)), ())
    assert (found.kind, found.suspect) == ("swap", "acceleration of DOFs 1 and 3")


def test_a_wrong_mass(problem):
    m = problem.structure.parameters["m"].clone()
    m[1] *= 5.0
    (found,) = refit_causes(replace(problem, structure=problem.structure.with_parameters(m=m)), ())
    assert (found.kind, found.suspect) == ("mass", "m_2")


def test_a_wrong_unit_of_time(problem):
    (found,) = refit_causes(replace(problem, record=replace(problem.record, time=1e3 * problem.record.time)), ())
    assert found.kind == "time_unit"


def test_prescribed_stiffnesses_are_not_refitted(problem):
    assert refit_causes(replace(problem, uncertain=()), ()) == []


def test_nor_is_a_nonlinear_chain(problem):
    m = problem.structure.parameters["m"] * 5.0
    parameters = problem.structure.parameters | {"m": m, "kappa": 0.0 * m + 100.0}
    assert refit_causes(replace(problem, structure=chain_of(parameters, Duffing())), ()) == []


def test_a_structure_that_is_released_has_no_spectra_to_compare(problem):
    record = replace(problem.record, force=np.zeros_like(problem.record.force))
    assert refit_causes(replace(problem, record=record), ()) == []
