"""Sparse recovery: sensors, what a force reaches, parameters that may move; no way from a problem to its truth."""

import dataclasses
import logging
import typing
from dataclasses import replace

import numpy as np
import pytest
from calls import refusal
from independent_records import frame_record
from omegaconf import OmegaConf
from small_problems import measured, small_chain

from pinn_cli.model.knowledge import EndState
from pinn_cli.record.record import Measurements, Record, Truth
from pinn_cli.record.response import Repeats
from pinn_cli.scheme.joint_problem import JointProblem, tell_if_unreached, unreached_dofs
from pinn_cli.scheme.problem import Problem, SpectralEstimate
from pinn_cli.scheme.scheme import Sensors, unobserved_dofs
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.system.connection import Nonlinearity
from pinn_cli.system.priors import Prior
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure

QUANTITIES = ("displacement", "velocity", "acceleration")
OTHER_SIGN = small_chain("van_der_pol").with_parameters(mu=-small_chain("van_der_pol").parameters["mu"])


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    return measured(small_chain(), duration=3.0, samples=33)


def test_accelerometers_on_the_first_dofs_by_default(measurements):
    seen = SparseRecovery().observe(measurements.record)
    np.testing.assert_array_equal(seen.sensors("acceleration"), [True, False, False])
    assert not seen.sensors("displacement").any()
    assert not seen.sensors("velocity").any()
    np.testing.assert_array_equal(seen.force, measurements.record.force)


def test_chosen_sensors_on_chosen_dofs(measurements):
    scheme = SparseRecovery(
        unobserved="every_2nd", sensors={"displacement": True, "velocity": True, "acceleration": False}
    )
    seen = scheme.observe(measurements.record)
    for quantity, expected in zip(QUANTITIES, ([1, 0, 1], [1, 0, 1], [0, 0, 0]), strict=True):
        np.testing.assert_array_equal(seen.sensors(quantity), np.array(expected, bool))


@pytest.mark.parametrize(
    ("structure", "uncertainty", "expected"),
    [
        (small_chain(), 0.2, {"c": 0.2, "k": 3.0, "kappa": 20.0}),
        (small_chain(k=16.0), None, {"c": 0.075, "k": 1.2, "kappa": 7.5}),
        (small_chain("linear"), 0.0, {}),
        (small_chain(k=0.0), None, {"c": 0.075, "kappa": 7.5}),  # a parameter of zero stays zero
        (OTHER_SIGN, None, {"c": 0.075, "k": 1.125, "mu": 0.05625}),
    ],
)
def test_every_parameter_but_the_masses_is_uncertain(measurements, structure, uncertainty, expected):
    settings = {} if uncertainty is None else {"parameter_uncertainty": uncertainty}
    problem = SparseRecovery(**settings).pose(structure, [measurements.record]).alone
    assert [(p.kind, p.index) for p in problem.uncertain] == [(kind, dof) for kind in expected for dof in range(3)]
    for p in problem.uncertain:
        assert p.prescribed == float(structure.parameters[p.kind][p.index])
        assert p.prior_std == pytest.approx(expected[p.kind])


def test_impossible_dofs_are_named_once_the_record_is_known(measurements):
    with pytest.raises(InputError, match=r"scheme\.unobserved="):
        SparseRecovery(unobserved=[4]).observe(measurements.record)


def hints(cls: type) -> dict[str, type]:
    """Types of a dataclass's fields, those included that are imported for type checkers alone."""
    return typing.get_type_hints(cls, localns={kind.__name__: kind for kind in (Prior, Repeats, Nonlinearity)})


def reachable(cls: type, seen: set[type]) -> set[type]:
    """Every dataclass that a field of a dataclass may hold."""
    if cls in seen:
        return seen
    seen.add(cls)
    for hint in hints(cls).values():
        for part in (hint, *typing.get_args(hint)):
            if isinstance(part, type) and dataclasses.is_dataclass(part):
                reachable(part, seen)
    return seen


def test_a_problem_has_no_way_to_the_truth():
    found = reachable(Problem, set())
    assert {Record, Structure, EndState, SpectralEstimate} <= found
    assert not {Truth, Measurements} & found
    assert not [name for name in dir(Record) if "true" in name or "truth" in name]


ENDS = {"a": ["ground", "x1"], "b": ["x1", "x2"], "c": ["ground", "x3"], "d": ["x2", "x3"]}


def posed(joint: tuple[float, float], unknown: str | list[str] = "k_a") -> Problem:
    """The frame's record, with a model whose third mass hangs on a connection of this c and k."""
    springs = dict.fromkeys(ENDS, (3000.0, 1.5e6)) | {"d": joint}
    connections = {n: {"between": ENDS[n], "law": "linear", "c": c, "k": k} for n, (c, k) in springs.items()}
    structure = build_structure(["x1", "x2", "x3"], {"x1": 2000, "x2": 2000, "x3": 2000}, connections)
    return StateParameter(unobserved=[], unknown=unknown).pose(structure, [frame_record(duration=8.0).record]).alone


@pytest.mark.parametrize(
    ("joint", "unknown", "there"),
    [
        ((0.0, 0.0), "k_a", [0, 1]),  # the roof's force stays on the roof
        ((0.0, 1.0), "k_a", []),
        ((1.0, 0.0), "k_a", []),  # a damper joins, too
        ((0.0, 0.0), ["k_a", "c_d"], []),
    ],
)
def test_what_a_force_reaches_is_what_is_joined_to_it(caplog, joint, unknown, there):
    problem = posed(joint, unknown)
    assert unreached_dofs(problem) == there
    with caplog.at_level(logging.WARNING):
        tell_if_unreached(JointProblem.of(problem))
    assert ("no force reaches DOFs 1, 2" in caplog.text) is bool(there)


def test_the_ground_reaches_everything_and_a_free_decay_needs_no_force():
    problem = posed((0.0, 0.0))
    record, nothing = problem.record, np.zeros_like(problem.record.force)
    columns = {q: getattr(record, q) for q in ("displacement", "velocity", "acceleration")}
    decay = Record(record.time, **columns, force=nothing, unforced=np.ones(3, bool))
    shaken = replace(decay, ground_acceleration=record.force[:, 2] / 2000.0)
    for other in (decay, shaken):
        assert unreached_dofs(SparseRecovery().pose(problem.structure, [other]).alone) == []


@pytest.mark.parametrize(
    ("ndof", "fraction", "unobserved", "hidden"),
    [
        (6, 0.67, None, [3, 4, 5, 6]),  # the last ones
        (6, 0.0, None, []),
        (1, 0.4, None, []),
        (3, 0.34, None, [3]),
        (6, 0.67, "every_2nd", [2, 4, 6]),
        (6, 0.67, "every_4th", [4]),
        (6, 0.67, "every_21st", []),
        (6, 0.67, (4, 2), [2, 4]),
        (6, 0.67, OmegaConf.create([2, 2, 4]), [2, 4]),
        (6, 0.67, [], []),
    ],
)
def test_a_fraction_a_pattern_or_a_list_hides_dofs(ndof, fraction, unobserved, hidden):
    assert unobserved_dofs(ndof, fraction, unobserved) == hidden


@pytest.mark.parametrize(
    ("fraction", "unobserved", "told"),
    [(x, None, "unobserved_fraction=.* from 0 to below 1") for x in (-0.1, 1.0, float("nan"), "half", None, True)]
    + [(0.95, None, "unobserved_fraction=0.95: .* rounds to all of them")]
    + [(0.67, x, "unobserved=.*every_2nd") for x in ("every_1st", "every_2", "every_second", "", "xevery_2nd")]
    + [(0.67, x, "unobserved=.*DOFs from 1 to 6; DOFs are counted from 1") for x in ([0], [7], [1.5], ["2"], [True])]
    + [(0.67, [3, 1, 2, 6, 5, 4], "unobserved=.*fewer than all 6 DOFs")],
)
def test_what_hides_no_dofs_is_refused(fraction, unobserved, told):
    with pytest.raises(InputError, match=rf"^scheme\.{told}"):
        unobserved_dofs(6, fraction, unobserved)


def test_quantities_come_in_the_records_order():
    sensors = Sensors.chosen({"acceleration": True, "velocity": False, "displacement": True}, 0.0, None)
    assert (sensors.quantities, sensors.load_cells) == (("displacement", "acceleration"), True)
    sensors = Sensors.chosen({"velocity": True, "force": False}, 0.0, None)
    assert (sensors.quantities, sensors.load_cells) == (("velocity",), False)


@pytest.mark.parametrize(
    ("sensors", "told"),
    [
        ({"jerk": True}, ".jerk=True"),
        ({"force": 1}, ".force=1"),
        ({"velocity": None}, ".velocity=None"),
        ({}, "={}: must be at least one of displacement, velocity, acceleration"),
        ({"acceleration": False}, "={'acceleration': False}: must be at least one of"),
    ],
)
def test_impossible_sensors_are_named(sensors, told):
    assert refusal(Sensors.chosen, sensors, 0.0, None).startswith(f"scheme.sensors{told}")
