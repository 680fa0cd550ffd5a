"""Orders of magnitude of a problem, from its record."""

from __future__ import annotations

import numpy as np

from pinn_cli.record.channels import record_band
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.problem import Problem

# How far a separate velocity output may be from the displacement's derivative, relative to the velocities that the
# force scale implies.
CONTINUITY_TOLERANCE = 1e-4


def newtons(problem: Problem) -> np.ndarray:
    """(forces,), N, the force on the coordinates of one unit of each input that nobody measured, roughly."""
    structure, inputs = problem.structure, problem.inputs
    of_forces = np.full(len(inputs.forces), structure.shapes.scale)
    if not inputs.misses_ground:
        return of_forces
    moved = structure.parameters["m"].detach().cpu().numpy() * structure.with_ground
    return np.append(of_forces, np.abs(moved).max())


def force_and_velocity_scale(problem: Problem) -> tuple[float, float]:
    """Force (N) and velocity (m/s) that the record is about.

    Rms of the measured force about its mean, or of mass times measured motion about its own: a steady load, the speed
    at which a shaft turns, vibrate nothing. A velocity is worth its acceleration at the band's middle, and so on; only
    orders of magnitude matter here. Where the coordinates are modes, both are theirs.
    """
    record = problem.record
    mass, per_force = problem.structure.parameters["m"].detach().cpu().numpy(), 1.0
    if problem.structure.is_modal:  # a DOF moves with modes of mass one, and a force on it acts on them
        per_force = problem.structure.shapes.scale
        mass = np.full(record.ndof, 1.0 / per_force)
    omega = np.pi * record_band(record)
    motion = [
        omega ** (2 - order) * mass * _varying(getattr(record, quantity))
        for order, quantity in enumerate(RESPONSE_QUANTITIES)
    ]
    inertia = float(np.nanmax(motion))
    measured = record.force[:, record.sensors("force")]
    force = per_force * float(np.sqrt(np.mean(_varying(measured) ** 2))) if measured.size else inertia
    force = force if force > 0 else inertia
    return force, force / float(mass.max()) / omega


def _varying(values: np.ndarray) -> np.ndarray:
    """(n,), rms of histories (N, n) about their means; of those that never change, of themselves."""
    about: np.ndarray = np.std(values, axis=0)
    return np.where(about > 0.0, about, np.sqrt(np.mean(values**2, axis=0)))
