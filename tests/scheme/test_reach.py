"""Sensors on a part of a structure that nothing joins to where a force acts."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from independent_records import frame_record

from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem, tell_if_unreached, unreached_dofs
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.topology import build_structure

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
