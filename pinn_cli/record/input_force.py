"""What the measured inputs of a record put into a structure's equations of motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.supports import measured_orders
from pinn_cli.system.parameters import MASS

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.system.structure import Structure


def input_force(structure: Structure, record: Record) -> np.ndarray:
    """(N, n), N: measured forces, and the ground's acceleration times the masses that it moves, S f - M iota a_g.

    Of supports their displacement times the springs that it stretches, or their acceleration times what it moves.
    """
    acting = structure.shapes.onto_coordinates(np.nan_to_num(record.force))
    mass = structure.parameters_like(np.empty(0))[MASS]
    if record.ground_acceleration is not None:
        acting = acting - np.outer(np.nan_to_num(record.ground_acceleration), mass * structure.with_ground)
    if structure.by_supports is None:
        return acting
    springs = (
        structure.at_rest()[0].sum(axis=0)[:, None] * structure.stretch.matrix[:, structure.coordinates :].toarray()
    )
    stiffness = abs(structure.incidence.matrix.T @ springs)
    for i, (quantity, order) in enumerate(measured_orders(record)):
        of_spring = stiffness[:, i] ** (1.0 - 0.5 * order)
        moved = of_spring * np.where(stiffness[:, i] > 0.0, mass, 0.0) ** (0.5 * order)
        acting = acting + np.outer(record.supports[quantity][:, i], moved)
    return acting
