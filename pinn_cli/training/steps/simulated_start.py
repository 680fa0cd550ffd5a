"""A motion to start from: what the prescribed chain does under the measured force."""

from __future__ import annotations

import numpy as np
import torch

from pinn_cli.record.free_run import NoFreeRunError, free_run
from pinn_cli.training.noise_model import FeatureProjection, first_output, output_features
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point


def simulated_start(equations: NormalEquations) -> Point | None:
    """The prescribed chain's motion from rest under the measured force, as readout weights.

    None where it cannot be had: a force is unknown, a parameter is, the motion does not stay finite, or velocity is an
    output of its own.
    """
    problem = equations.problem
    if problem.identifies or equations.network.channels > 1:
        return None
    try:
        motion = free_run(problem.structure, problem.record)
    except NoFreeRunError:
        return None
    coordinates = motion.displacement if motion.coordinates is None else motion.coordinates[:, 0]
    supports = None if motion.supports is None else motion.supports[:, 0]
    functions = [coordinates, *(x for x in (motion.hidden, supports, motion.ground_acceleration) if x is not None)]
    every = np.column_stack([*functions, problem.record.force[:, list(problem.inputs.loads)]])
    segments, network = equations.observation, equations.network
    projection = FeatureProjection(first_output(network, segments), output_features(network, segments)[0])
    like = equations.target.force
    weights = projection.coefficients(torch.as_tensor(every).to(like))
    return Point(equations.layout.unknowns(weights.to(like)), equations.start().parameters)
