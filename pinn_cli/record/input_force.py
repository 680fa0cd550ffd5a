"""What the measured inputs of a record put into a structure's equations of motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system.parameters import MASS

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.system.structure import Structure


def input_force(structure: Structure, record: Record) -> np.ndarray:
    """(N, n), N: measured forces, and the ground's acceleration times the masses that it moves, S f - M iota a_g."""
    acting = np.nan_to_num(record.force)
    acting = acting if structure.shapes is None else structure.shapes.onto_coordinates(acting)
    if record.ground_acceleration is None:
        return acting
    moved = structure.parameters_like(np.empty(0))[MASS] * structure.with_ground
    out: np.ndarray = acting - np.outer(np.nan_to_num(record.ground_acceleration), moved)
    return out
