"""What acts on a structure beside the forces that were measured: the ground, and forces that nobody measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.linalg import qr

from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.functions import FLAT, Inputs
from pinn_cli.system.quantities import FORCE
from pinn_cli.system.shapes import Shapes
from pinn_cli.system.structure import Structure

GAUSSIAN_PROCESS, FREE = "gaussian_process", "free"
# How a force that nobody measured is estimated: as a Gaussian process, or as whatever the motion takes.
UNKNOWN_FORCES = (GAUSSIAN_PROCESS, FREE)
# Periods of the record's highest frequency that the correlation time of an unknown force starts at: its edge is there.
FIRST_CORRELATION = FLAT / math.pi


def inputs_of(structure: Structure, record: Record, unknown_force: str = GAUSSIAN_PROCESS) -> Inputs:
    """The inputs of a problem.

    Args:
        structure: Prescribed.
        record: What was measured.
        unknown_force: One of :data:`UNKNOWN_FORCES`.

    Raises:
        InputError: A record that a structure in modal coordinates cannot be asked about.
    """
    if structure.is_modal:
        _check_modal(structure.shapes, record, unknown_force)
    left_open = ~record.unforced & ~record.sensors("force")
    forces = tuple(int(dof) for dof in np.flatnonzero(left_open)) if unknown_force == GAUSSIAN_PROCESS else ()
    if forces and record.misses_ground:
        allowed, hint = "measured where nobody measured the ground", "nothing tells one from the other"
        raise InputError("data.force", f"null on {record.dof_names(forces)}", allowed, hint)
    functions = structure.is_modal or any(channel.quantity == FORCE for channel in record.calibrated)
    loads = tuple(int(dof) for dof in np.flatnonzero(record.sensors(FORCE))) if functions else ()
    filters = tuple(channel.index for channel in record.calibrated if channel.filter_order)
    together = bool(filters) or not all(channel.feels_one for channel in record.calibrated)
    if (
        not forces
        and not loads
        and record.ground_acceleration is None
        and not len(structure.memory)
        and not record.supports
    ):
        return Inputs(together=together, filters=filters)
    band = record_band(record)
    return Inputs(
        record.ground_acceleration is not None,
        not record.misses_ground,
        record.frame == "absolute",
        forces,
        FIRST_CORRELATION / band,
        rate=math.pi * band,
        edge=2.0 * math.pi * band,
        loads=loads,
        together=together,
        filters=filters,
        supports=tuple(record.supports),
    )


def with_every_force(problem: Problem) -> Problem:
    """The same problem with a force that nobody measured on every coordinate, beside those that were.

    Where these are modes, on as many DOFs, which they move in the most different ways.
    """
    band, shapes = record_band(problem.record), problem.structure.shapes.matrix
    dofs = np.sort(qr(shapes.T, mode="r", pivoting=True)[1][: shapes.shape[1]])
    forces = tuple(int(dof) for dof in dofs)
    inputs = replace(
        problem.inputs,
        forces=forces,
        correlation_time=FIRST_CORRELATION / band,
        rate=math.pi * band,
        edge=2.0 * math.pi * band,
    )
    return replace(problem, inputs=inputs)


def _check_modal(shapes: Shapes, record: Record, unknown_force: str) -> None:
    """What cannot be said of modes: forces on them are the same ones as on the DOFs."""
    if record.intersample != "band_limited":
        allowed, hint = "band_limited with system=matrices", "a held force is no force of a mode"
        raise InputError("data.intersample", record.intersample, allowed, hint)
    left_open = ~record.unforced & ~record.sensors("force")
    if unknown_force == FREE and left_open.any():
        hint = "the motion of a few modes leaves no force open"
        raise InputError("scheme.unknown_force", FREE, f"{GAUSSIAN_PROCESS} with system=matrices", hint)
    if record.ground_acceleration is not None:
        shapes.check_ground()
