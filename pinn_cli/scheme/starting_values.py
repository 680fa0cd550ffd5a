"""How large a parameter may be that nobody knows, read off the record: where it starts, and how far it may go."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.record.amplitudes import motion_amplitudes
from pinn_cli.record.record import Record
from pinn_cli.system.parameters import MASS
from pinn_cli.system.structure import Structure


def parameter_scales(structure: Structure, records: Sequence[Record]) -> dict[str, float]:
    """Kind of parameter to the value with which it alone would carry the force that acts, at the motion that there is.

    With F, U, V, A the root mean squares of force, displacement, velocity and acceleration: m is F / A, c is F / V, k
    is F / U, and a nonlinear parameter is F over the force that a value of one makes at (U, V). Only orders of
    magnitude: an elongation is not a displacement. Of several records the median counts.

    Args:
        structure: For its laws and, where no force is measured, its masses.
        records: What was measured.
    """
    every = [_scales(structure, record) for record in records]
    return {kind: float(np.median([scales[kind] for scales in every])) for kind in every[0]}


def _scales(structure: Structure, record: Record) -> dict[str, float]:
    size = motion_amplitudes(record)
    measured = record.force[:, record.sensors("force")]
    force = float(np.sqrt(np.mean(measured**2))) if measured.size else 0.0
    masses = structure.parameters[MASS].detach().cpu().double().numpy()
    known = masses[np.isfinite(masses) & (masses > 0)]
    # Without a load cell the force is that of the masses; where nobody knows those either, of one kilogram.
    force = force if force > 0 else size["acceleration"] * (float(np.median(known)) if known.size else 1.0)
    scales = {"m": force / size["acceleration"]}
    for kind, alone in unit_forces(structure, size["displacement"], size["velocity"]).items():
        per_unit = float(alone.max())
        scales[kind] = force / per_unit if per_unit > 0 else 1.0
    return scales


def unit_forces(structure: Structure, elongation: float, rate: float) -> dict[str, np.ndarray]:
    """Kind of the connections' parameters to the size of the force that a value of one makes alone (members,), N.

    Args:
        structure: For its laws; its parameters are not read.
        elongation: Of every connection, m.
        rate: Of it, m/s.
    """
    e, de = (np.full(structure.incidence.shape[0], value) for value in (elongation, rate))
    forces = {}
    for kind, members in structure.members.items():
        alone = {name: np.full(len(other), float(name == kind)) for name, other in structure.parameters.items()}
        forces[kind] = np.abs(structure.connection_force(e, de, alone)[members])
    return forces


def starting_value(kind: str, scale: float) -> float:
    """Where an unknown parameter starts when the user does not say: masses and springs at their scale, others at 0.

    A chain without damping and nonlinearity is a chain; one without springs or masses is none.
    """
    return scale if kind in ("m", "k") else 0.0
