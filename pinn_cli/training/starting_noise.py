"""Where the noise levels of a problem start."""

from __future__ import annotations

import math

import numpy as np

from pinn_cli.record.channels import support_amplitudes
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import FORCE, GROUND, MOTION, SUPPORT
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_scales import CONTINUITY_TOLERANCE, force_and_velocity_scale, newtons
from pinn_cli.training.sensor_samples import starting_levels


def starting_noise(equations: NormalEquations) -> NoiseModel:
    """Where the noise levels of one record start; the discrepancy is the force that acts."""
    problem = equations.problem
    force, velocity = force_and_velocity_scale(problem)
    quantities = [*problem.record.response_quantities, *((FORCE,) if problem.dynamics.inputs.loads else ())]
    response = {quantity: np.full(len(problem.record.sensors(quantity)), np.nan) for quantity in quantities}
    response |= {channels.name: channels.numbers("first") for channels in equations.channels}
    if equations.observer is not None:
        response["acceleration"] = starting_levels(problem.record, "acceleration")
    points, dynamics = equations.refinement, problem.dynamics
    innovation, sensors = np.full((2, dynamics.size), np.nan)
    if equations.target.measured_force.any():  # otherwise load cells are channels
        sensors[: dynamics.ndof] = starting_levels(problem.record, FORCE)
    # A force of modes acts on a DOF the more, the less this DOF moves with them.
    innovation[dynamics.forces] = force / newtons(problem)
    innovation[dynamics.loads] = [np.std(problem.record.force[:, dof]) for dof in dynamics.inputs.loads]
    if problem.record.measured_ground is not None:
        innovation[dynamics.ground] = np.std(problem.record.measured_ground)
    if dynamics.structure.supports:
        innovation[dynamics.supports] = support_amplitudes(problem.record)
    continuity = CONTINUITY_TOLERANCE * velocity
    return NoiseModel(
        response,
        sensors,
        force,
        continuity,
        points_per_sample=points,
        innovation=None if dynamics.is_plain else innovation,
        pushes=_pushes(equations),
    )


def _pushes(equations: NormalEquations) -> dict[str, np.ndarray]:
    """See :class:`NoiseModel`; a support's displacement pushes by a spring, its acceleration by a mass."""
    structure, record = equations.problem.structure, equations.problem.record
    masses = structure.parameters[MASS].detach().cpu().numpy()
    by_quantity = {FORCE: structure.shapes.scale}
    if record.measured_ground is not None:
        by_quantity[GROUND] = _least(masses * structure.with_ground)
    if structure.by_supports is not None:
        moved = abs(structure.by_supports).sum(axis=1).A1 > 0.0
        stiffness, mass = _least(structure.at_rest()[0].sum(axis=0)[: len(moved)][moved]), _least(masses)
        for quantity in record.supports:
            order = MOTION.index(SUPPORT[quantity])
            by_quantity[quantity] = stiffness ** (1.0 - order / 2.0) * mass ** (order / 2.0)
    return {
        channels.name: np.array(
            [by_quantity.get(sensor.channel.quantity, np.nan) if sensor else np.nan for sensor in channels.sensors]
        )
        for channels in equations.channels
    }


def _least(values: np.ndarray) -> float:
    """Size of the least that is not zero."""
    return float(np.min(np.abs(values[values != 0.0]), initial=math.inf))
