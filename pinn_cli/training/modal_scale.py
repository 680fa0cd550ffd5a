"""How fast modes move: what the motion of a record's sensors implies for all of them, also for those that none sees."""

from __future__ import annotations

import numpy as np

from pinn_cli.record.amplitudes import motion_amplitudes
from pinn_cli.record.channels import record_band
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import MASS
from pinn_cli.training.record_scales import force_and_velocity_scale

# Standard deviations of a mode's motion, over what a force that acts on all modes alike would make it.
WIDE = 3.0
# Damping ratio of modes at least, and frequencies at which their response is summed up.
LEAST_DAMPING, FREQUENCIES = 0.02, 4096


def modal_deviation(problem: Problem) -> np.ndarray | None:
    """(n, 2), standard deviations of the velocity and the acceleration of every coordinate at any time.

    A random force, flat over the record's band and as large on every mode, whose response is as large as that of the
    sensors: in the band modes resonate, above it they follow slowly, and no more. None where coordinates are no modes.
    """
    structure, record = problem.structure, problem.record
    if not structure.is_modal:
        return None
    n = structure.coordinates
    p = structure.parameters_like(np.empty(0))
    m = p[MASS]
    omega = np.sqrt(np.maximum(p["k"][:n] / m, 0.0))
    damping = np.maximum(p["c"][:n] / m, 2.0 * LEAST_DAMPING * omega)
    band = 2.0 * np.pi * record_band(record)
    w = np.geomspace(min(2.0 * np.pi / record.duration, 0.5 * band), band, FREQUENCIES)
    power = m[:, None] ** -2.0 / ((omega[:, None] ** 2 - w**2) ** 2 + (damping[:, None] * w) ** 2)
    velocity, acceleration = (np.trapezoid(power * w**order, w) / band for order in (2, 4))
    of_dofs = structure.shapes.matrix**2 @ acceleration
    seen = any(record.sensors(quantity).any() for quantity in RESPONSE_QUANTITIES)
    level = force_and_velocity_scale(problem)[0]
    if seen:
        level = motion_amplitudes(record)["acceleration"] / float(np.sqrt(of_dofs.mean()))
    deviation: np.ndarray = WIDE * level * np.sqrt(np.stack((velocity, acceleration), axis=1))
    return deviation
