"""What acts on a structure beside the forces that were measured: the ground, and forces that nobody measured."""

from __future__ import annotations

import math

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import record_band
from pinn_cli.system.dynamics import Inputs
from pinn_cli.system.structure import Structure

GAUSSIAN_PROCESS, FREE = "gaussian_process", "free"
# How a force that nobody measured is estimated: as a Gaussian process, or as whatever the motion takes.
UNKNOWN_FORCES = (GAUSSIAN_PROCESS, FREE)
# Periods of the record's highest frequency that the correlation time of an unknown force starts at: white, nearly.
FIRST_CORRELATION = 0.25


def inputs_of(structure: Structure, record: Record, unknown_force: str = GAUSSIAN_PROCESS) -> Inputs:
    """The inputs of a problem.

    Args:
        structure: Prescribed.
        record: What was measured.
        unknown_force: One of :data:`UNKNOWN_FORCES`.
    """
    left_open = ~record.unforced & ~record.sensors("force")
    forces = tuple(int(dof) for dof in np.flatnonzero(left_open)) if unknown_force == GAUSSIAN_PROCESS else ()
    if not forces and record.ground_acceleration is None and not len(structure.memory):
        return Inputs()
    band = record_band(record)
    return Inputs(
        record.ground_acceleration is not None,
        record.frame == "absolute",
        forces,
        FIRST_CORRELATION / band,
        math.pi * band,
        2.0 * math.pi * band,
    )
