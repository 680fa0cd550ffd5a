"""The response that a trained network stands for."""

from __future__ import annotations

import torch

from pinn_cli.network.base import Network
from pinn_cli.physics import Targets, estimated_response
from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.learned_parameters import LearnedParameters


@torch.no_grad()
def network_response(problem: Problem, every: Targets, network: Network, parameters: LearnedParameters) -> Response:
    """Motion and force at the record's samples, see :func:`pinn_cli.physics.estimated_response`.

    Args:
        problem: Structure and record.
        every: The record's targets at all its samples.
        network: Of the motion.
        parameters: Of the chain.
    """
    at_observation, at_physics = network(every.observation_time), network(every.physics_time)
    return estimated_response(problem.record, problem.dynamics, parameters(), at_observation, at_physics)
