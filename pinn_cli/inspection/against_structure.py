"""A record beside a structure that was given: what makes the structure do what was measured, where it does not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.system.structure import Structure
from pinn_cli.verdict.causes import causes


def contradictions(structure: Structure, signals: Sequence[Signal], sampling: Sampling) -> list[str]:
    """Sentences of what the verdict would look for: a unit, a sign, a place, a mass; none where the structure fits.

    Args:
        structure: All of its parameters are given.
        signals: Columns of the record; those whose place is no DOF are left out.
        sampling: Of their values.
    """
    columns = {quantity: np.full((len(sampling.regular), structure.ndof), np.nan) for quantity in QUANTITIES}
    unforced, ground = np.ones(structure.ndof, dtype=bool), None
    for signal in (signal for signal in signals if signal.varies):
        values = sampling.on_regular(signal.values)
        dof = int(signal.place) - 1 if signal.place.isdigit() else -1
        if signal.quantity == GROUND:
            ground = values - values.mean()
        elif signal.quantity in columns and 0 <= dof < structure.ndof:
            columns[signal.quantity][:, dof] = values - values.mean()
            unforced[dof] &= signal.quantity != FORCE
    columns[FORCE] = np.nan_to_num(columns[FORCE])
    if not any(np.isfinite(columns[quantity]).any() for quantity in columns if quantity != FORCE):
        return []
    u, v, a, f = (columns[quantity] for quantity in QUANTITIES)
    record = Record(sampling.regular, u, v, a, f, unforced, ground_acceleration=ground)
    return [finding.text for finding in causes(Problem(structure, record), structure, structure)]
