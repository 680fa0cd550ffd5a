"""Faults of finite-element models, nonlinear chains and frames under earthquakes are named beside what is unknown."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from beams import beam, beam_part, deflection, response
from frame_records import altered, measure
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


def found(problem, astray):
    """From where a fault has led the estimate."""
    return causes(problem, problem.structure, problem.structure.with_parameters(**astray))


def exchanged(record):
    return replace(record, acceleration=record.acceleration[:, [1, 0, 2, 3]])


def elsewhere(record):
    """The sensor that is on the second DOF is said to be on the fourth."""
    return replace(record, acceleration=record.acceleration[:, [0, 3, 2, 1]])


FAULTS = [
    (lambda r: altered(r, 1, lambda x: -x), "sign", "acceleration of DOF tip"),
    (lambda r: altered(r, 3, lambda x: 1.4 * x), "gain", "acceleration of DOF b"),
    (lambda r: altered(r, 2, lambda x: np.roll(x, 3)), "delay", "acceleration of DOF a"),
    (lambda r: altered(r, 1, lambda x: 1.5 * x, "force"), "gain", "force of DOF tip"),
    (exchanged, "swap", "acceleration of DOFs tip and a"),
    (elsewhere, "misplaced", "acceleration of DOF c"),
]


@pytest.mark.parametrize(("ruin", "kind", "suspect"), FAULTS)
def test_a_fault_of_a_finite_element_model_s_record_is_named(beam_problem, ruin, kind, suspect):
    problem = replace(beam_problem, record=ruin(beam_problem.record))
    (cause,) = found(problem, {"factor": torch.tensor([2.0, 0.4], dtype=torch.float64)})
    assert (cause.kind, cause.suspect) == (kind, suspect)


def test_a_finite_element_model_whose_record_is_right_has_none(beam_problem):
    assert found(beam_problem, {"factor": torch.tensor([2.0, 0.4], dtype=torch.float64)}) == []


def test_a_mass_that_is_wrong_is_told_with_the_stiffnesses_beside_it():
    structure = small_chain("linear", 3)
    unknown = tuple(Parameter("k", i, 10.0, 100.0, unknown=True, positive=True) for i in range(3))
    masses, k = structure.parameters["m"], structure.parameters["k"].numpy()
    lighter = structure.with_parameters(m=masses * torch.tensor([1.0, 0.5, 1.0], dtype=torch.float64))
    (cause,) = found(Problem(lighter, measure(structure), unknown), {"k": torch.as_tensor(k * [0.9, 0.93, 1.0])})
    assert (cause.kind, cause.suspect) == ("mass", "m_2")
    told = {name: float(value) for name, value in re.findall(r"(k_\d) = ([0-9.e+-]+)", cause.text)}
    assert told == pytest.approx({"k_1": k[0], "k_2": k[1]}, rel=0.03)


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


@pytest.mark.parametrize(
    ("ruin", "kind", "suspect"),
    [
        (lambda r: altered(r, 3, lambda x: -x), "sign", "acceleration of DOF 3"),
        (lambda r: replace(r, acceleration=r.acceleration[:, [1, 0, 2]]), "swap", "acceleration of DOFs 1 and 2"),
        (lambda r: altered(r, 3, lambda x: 1.5 * x, "force"), "gain", "force of DOF 3"),
    ],
)
def test_a_fault_of_a_nonlinear_chain_s_record_is_named(cubic_problem, ruin, kind, suspect):
    problem = replace(cubic_problem, record=ruin(cubic_problem.record))
    (cause,) = found(problem, {"k": torch.tensor([40.0, 5.0, 20.0], dtype=torch.float64)})
    assert (cause.kind, cause.suspect) == (kind, suspect)


def test_what_is_not_linear_is_no_fault(cubic_problem):
    assert found(cubic_problem, {}) == []


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
