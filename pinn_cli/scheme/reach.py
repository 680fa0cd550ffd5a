"""Parts of a structure that nothing joins to where a force acts: none of the model moves their sensors."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system.parameters import MASS

if TYPE_CHECKING:
    from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem

log = logging.getLogger(__name__)


def unreached_dofs(problem: Problem) -> list[int]:
    """DOFs with a sensor, counted from 0, that no force reaches while one acts elsewhere; they can only swing freely.

    A connection joins its ends if it has a force where it is stretched or moves, or may have: what is unknown.

    Args:
        problem: Of one record. The modes of a finite-element model are joined by their shapes.
    """
    from scipy.sparse.csgraph import connected_components

    structure, record = problem.structure, problem.record
    if structure.is_modal:
        return []
    count = structure.incidence.shape[0]
    parameters = structure.parameters_like(np.empty(0))
    force = structure.connection_force(np.ones(count), np.ones(count), parameters)
    joins = np.isnan(force) | (force != 0)
    joins[structure.memory] = True
    for parameter in (p for p in problem.uncertain if p.unknown and p.kind in structure.carriers and p.kind != MASS):
        connections, which = structure.carriers[parameter.kind]
        joins[connections[which == parameter.index]] = True
    stretch = abs(structure.incidence.matrix[joins])
    _, part = connected_components(stretch.T @ stretch, directed=False)
    acting = ~record.unforced
    if record.ground_acceleration is not None:
        acting = acting | (structure.with_ground != 0)
    if structure.by_supports is not None:
        carried = (abs(structure.stretch.matrix[joins]).T @ abs(structure.stretch.matrix[joins]))[:, len(acting) :]
        acting = acting | (carried.sum(axis=1).A1[: len(acting)] > 0.0)
    reached = np.isin(part, part[acting])
    return np.flatnonzero(record.observed & ~reached).tolist() if reached.any() else []


def tell_if_unreached(problem: JointProblem) -> None:
    """Say before anything is solved which sensors no force of the model can move."""
    for number, record_problem in enumerate(problem, start=1):
        dofs = unreached_dofs(record_problem)
        if dofs:
            of = f"record {number}: " if len(problem) > 1 else ""
            text = "%sno force reaches %s, where there is a sensor: no connection joins it to where one acts; add the "
            log.warning(text + "connection, or the force there (data.force)", of, record_problem.record.dof_names(dofs))
