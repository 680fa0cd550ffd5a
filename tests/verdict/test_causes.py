"""Faults of frames, finite-element models and nonlinear chains are named beside what is unknown."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from beams import beam, beam_part, deflection, response
from frame_records import altered, exchanged, measure
from scipy.io import mmwrite
from small_problems import small_chain

from pinn_cli.record.record import Record
from pinn_cli.scheme.linear_fit import LinearFit, LinearStructure
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.starts import linear_parts
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.parameters import Parameter
from pinn_cli.verdict.causes import causes

DOFS = {"tip": deflection(10), "a": deflection(5), "b": deflection(8), "c": deflection(3)}
PARTS, TRUE = {"base": range(5), "top": range(5, 10)}, (0.8, 1.2)


@pytest.fixture(scope="module")
def beam_problem(tmp_path_factory):
    """A beam of which both halves' stiffness is unknown, its tip driven; three of four DOFs have an accelerometer."""
    folder = tmp_path_factory.mktemp("beam")
    M, K = beam(10)
    np.savez(folder / "beam.npz", M=M.toarray(), K=K.toarray())
    for name, own in PARTS.items():
        mmwrite(str(folder / f"{name}.mtx"), beam_part(10, own))
    factors = {name: f"{name}.mtx" for name in PARTS}
    structure = build_finite_elements(
        path="beam.npz", base=folder, factors=factors, dofs=DOFS, modes=4, damping={"ratio": 0.02}, loaded=["tip"]
    )
    random, step, samples = np.random.default_rng(0), 1.0 / 300.0, 1200
    time = step * np.arange(samples)
    frequencies, phases = random.uniform(1.0, 45.0, 80), random.uniform(0.0, 2.0 * np.pi, 80)
    force = np.sin(2.0 * np.pi * np.outer(time, frequencies) + phases).sum(1)
    softer = sum(factor * beam_part(10, own) for factor, own in zip(TRUE, PARTS.values(), strict=True))
    _, _, whole = response(M, softer, 0.02, (DOFS["tip"], force), step)
    shown = whole[:, [dof - 1 for dof in DOFS.values()]]
    shown = shown + 0.01 * shown.std(0) * random.standard_normal(shown.shape)
    shown[:, 3] = np.nan
    nothing = np.full(shown.shape, np.nan)
    load = np.column_stack((force, np.zeros((samples, 3))))
    record = Record(time, nothing, nothing, shown, load, np.array([False, True, True, True]), dofs=tuple(DOFS))
    unknown = tuple(Parameter("factor", i, 1.0, 10.0, unknown=True, label=name) for i, name in enumerate(PARTS))
    return Problem(structure, record, unknown)


@pytest.fixture(scope="module")
def cubic_problem():
    """A chain of cubic springs, of which nothing but the masses and dampers is known."""
    structure = small_chain("duffing", 3)
    unknown = tuple(
        Parameter(kind, i, size, 10.0 * size, unknown=True, positive=True)
        for kind, size in (("k", 10.0), ("kappa", 50.0))
        for i in range(3)
    )
    return Problem(structure, measure(structure, strength=2.0), unknown)


@pytest.fixture
def frame_problem(frame, frame_record):
    """A frame whose stiffnesses are right."""
    return Problem(frame, frame_record, ())


def found(problem, excused=(), **astray):
    """Causes, where a fault has led the estimate astray."""
    led = {kind: torch.tensor(values, dtype=torch.float64) for kind, values in astray.items()}
    return causes(problem, problem.structure, problem.structure.with_parameters(**led), excused)


def turned(record):
    return altered(record, 3, lambda x: -x)


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


ASTRAY = {"frame": {}, "beam": {"factor": [2.0, 0.4]}, "cubic": {"k": [40.0, 5.0, 20.0]}}
THIRD = "acceleration of DOF 3"
FAULTS = [
    ("frame", lambda r: altered(r, 3, lambda x: x / 9.80665), "unit", THIRD),
    ("frame", lambda r: altered(r, 3, lambda x: 3.0 * x), "gain", THIRD),
    ("frame", turned, "sign", THIRD),
    ("frame", lambda r: altered(r, 3, lambda x: np.roll(x, 3)), "delay", THIRD),
    ("frame", lambda r: exchanged(r, 1, 3), "swap", "acceleration of DOFs 1 and 3"),
    ("beam", lambda r: altered(r, 1, lambda x: -x), "sign", "acceleration of DOF tip"),
    ("beam", lambda r: altered(r, 3, lambda x: 1.4 * x), "gain", "acceleration of DOF b"),
    slow("beam", lambda r: altered(r, 2, lambda x: np.roll(x, 3)), "delay", "acceleration of DOF a"),
    ("beam", lambda r: altered(r, 1, lambda x: 1.5 * x, "force"), "gain", "force of DOF tip"),
    slow("beam", lambda r: exchanged(r, 1, 2), "swap", "acceleration of DOFs tip and a"),
    # The sensor that is on the second DOF is said to be on the fourth.
    slow("beam", lambda r: exchanged(r, 2, 4), "misplaced", "acceleration of DOF c"),
    slow("cubic", turned, "sign", THIRD),
    slow("cubic", lambda r: exchanged(r, 1, 2), "swap", "acceleration of DOFs 1 and 2"),
    ("cubic", lambda r: altered(r, 3, lambda x: 1.5 * x, "force"), "gain", "force of DOF 3"),
]


@pytest.mark.parametrize(("name", "ruin", "kind", "suspect"), FAULTS)
def test_the_fault_of_a_record_is_named(request, name, ruin, kind, suspect):
    problem = request.getfixturevalue(f"{name}_problem")
    (cause,) = found(replace(problem, record=ruin(problem.record)), **ASTRAY[name])
    assert (cause.kind, cause.suspect) == (kind, suspect)


def test_a_finite_element_model_whose_record_is_right_has_none(beam_problem):
    assert found(beam_problem, **ASTRAY["beam"]) == []


def test_a_mass_that_is_wrong_is_told_with_the_stiffnesses_beside_it():
    structure = small_chain("linear", 3)
    unknown = tuple(Parameter("k", i, 10.0, 100.0, unknown=True, positive=True) for i in range(3))
    masses, k = structure.parameters["m"], structure.parameters["k"].numpy()
    lighter = structure.with_parameters(m=masses * torch.tensor([1.0, 0.5, 1.0], dtype=torch.float64))
    (cause,) = found(Problem(lighter, measure(structure), unknown), k=k * [0.9, 0.93, 1.0])
    assert (cause.kind, cause.suspect) == ("mass", "m_2")
    told = {name: float(value) for name, value in re.findall(r"(k_\d) = ([0-9.e+-]+)", cause.text)}
    assert told == pytest.approx({"k_1": k[0], "k_2": k[1]}, rel=0.03)


def test_what_is_not_linear_is_no_fault(cubic_problem):
    assert found(cubic_problem) == []


def test_slopes_by_factors_are_those_of_the_misfit(beam_problem):
    structure, unknown = beam_problem.structure, beam_problem.uncertain
    linear = LinearStructure(structure, linear_parts(structure, unknown), linear_parts(structure, ())["k"])
    fit = LinearFit(beam_problem.record, linear)
    x = linear.start(np.ones(structure.coordinates), np.append(np.ones(structure.coordinates), TRUE))
    slopes = fit.slopes(x)
    assert slopes.shape[-1] == len(x) == 3  # two factors and the damping
    for i, move in enumerate(1e-6 * np.eye(3)):
        rise = (fit.residual(x + move) - fit.residual(x - move)) / 2e-6
        np.testing.assert_allclose(slopes[..., i], rise, atol=1e-6 * np.abs(rise).max())


@pytest.fixture
def from_afar(frame, frame_record):
    """The same whose stiffnesses are unknown, and started 5 times too low."""
    unknown = tuple(Parameter("k", dof, 3.0, 30.0, unknown=True, positive=True) for dof in range(3))
    return Problem(frame.with_parameters(k=frame.parameters["k"] / 5.0), frame_record, unknown)


def test_no_cause_is_made_up(frame_problem):
    """For a good record, a channel that is excused, or a structure that is released and has no spectra to compare."""
    assert found(frame_problem) == []
    excused = found(replace(frame_problem, record=turned(frame_problem.record)), [THIRD])
    assert all(cause.suspect != THIRD for cause in excused)
    released = replace(frame_problem.record, force=np.zeros_like(frame_problem.record.force))
    assert found(replace(frame_problem, record=released)) == []


@pytest.mark.slow
def test_causes_beside_stiffnesses_that_are_unknown(from_afar):
    assert found(from_afar) == []
    (cause,) = found(replace(from_afar, record=turned(from_afar.record)))
    assert (cause.kind, cause.suspect) == ("sign", THIRD)
    m = from_afar.structure.parameters["m"].clone()
    m[1] *= 0.5
    (cause,) = found(replace(from_afar, structure=from_afar.structure.with_parameters(m=m)))
    assert (cause.kind, cause.suspect) == ("mass", "m_2")


def test_a_sensor_that_is_still_and_excused_hides_no_other_one(frame_problem):
    spoilt = altered(turned(frame_problem.record), 2, lambda x: 0.0 * x)
    (cause,) = found(replace(frame_problem, record=spoilt), ["acceleration of DOF 2"])
    assert (cause.kind, cause.suspect) == ("sign", THIRD)


@pytest.mark.slow
def test_exchanged_sensors_that_led_the_estimate_astray(from_afar):
    k = from_afar.structure.parameters["k"]
    astray = from_afar.structure.with_parameters(k=k * k.new_tensor([1e-3, 50.0, 200.0]))
    spoilt = replace(from_afar, record=exchanged(from_afar.record, 1, 3))
    (cause,) = causes(spoilt, from_afar.structure, astray)
    assert (cause.kind, cause.suspect) == ("swap", "acceleration of DOFs 1 and 3")


def test_a_sign_that_led_the_search_and_its_start_astray(from_afar):
    k = from_afar.structure.parameters["k"]
    astray = from_afar.structure.with_parameters(k=5.0 * k * k.new_tensor([50.0, 0.05, 0.02]))
    spoilt = replace(from_afar, structure=astray, record=altered(from_afar.record, 1, lambda x: -x))
    (cause,) = found(spoilt)
    assert (cause.kind, cause.suspect) == ("sign", "acceleration of DOF 1")


@pytest.mark.parametrize(("dof", "factor"), [(1, 5.0), (2, 0.5)])
def test_a_wrong_mass_and_wrong_dampers(frame_problem, dof, factor):
    m = frame_problem.structure.parameters["m"].clone()
    m[dof - 1] *= factor
    (cause,) = found(replace(frame_problem, structure=frame_problem.structure.with_parameters(m=m)))
    assert (cause.kind, cause.suspect) == ("mass", f"m_{dof}")
    assert abs(float(cause.text.split()[3]) - 10.0) < 0.5
    wrong = frame_problem.structure.with_parameters(c=10.0 * frame_problem.structure.parameters["c"])
    (cause,) = found(replace(frame_problem, structure=wrong))
    assert cause.kind == "damping"


@pytest.mark.parametrize(("scale", "told"), [(1e3, "milliseconds"), (1 / 60, "minutes")])
def test_a_time_axis_in_another_unit(frame, frame_record, scale, told):
    (cause,) = found(Problem(frame, replace(frame_record, time=frame_record.time * scale), ()))
    assert (cause.kind, cause.word) == ("time_unit", "failed")
    assert told in cause.text


def test_a_structure_that_is_wrong_in_many_ways_has_no_one_cause(frame, frame_record):
    wrong = frame.with_parameters(k=frame.parameters["k"] * frame.parameters["k"].new_tensor([0.3, 3.0, 0.2]))
    assert found(Problem(wrong, frame_record, ())) == []
