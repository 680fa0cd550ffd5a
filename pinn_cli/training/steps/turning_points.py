"""Where contacts stick or turn round: no spline follows the corners of the motion there.

What a spline leaves of the equation of motion in these intervals is its own error, ten times as large as anywhere else.
As one level with all else it passes for a force that the model leaves out: parameters are then known ten times as badly
as the sliding tells them. So these intervals have a level of their own, that of what is left in them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from pinn_cli.network.spline import SplineNetwork
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem, TurningPoints
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point
from pinn_cli.training.solver import Inference

# A contact turns where it is slower than so many times the speed over which its friction does.
STRAIGHT = 3.0
# Beyond this part of the intervals too few are left to learn from.
MOST = 0.8
# How much larger the error is about turns where a solution with one level says less: that one spreads it over all.
FIRST = 10.0


def has_turns(problem: Problem) -> bool:
    """Whether an estimator solves another law than that of a contact, which a spline cannot follow."""
    return problem.dynamics.structure is not problem.structure


def with_turning_points(found: Inference, problem: JointProblem) -> JointProblem:
    """The problem with the turning points of a solution of it; the same where all laws are smooth."""
    if not has_turns(problem.each[0]):
        return problem
    each = zip(problem, found.by_record, found.trained.noise.records, strict=True)
    turning = ((one, _turning_points(*own, noise.discrepancy)) for one, own, noise in each)
    return JointProblem.of(*(replace(one, turning_points=points) for one, points in turning))


def _turning_points(equations: NormalEquations, point: Point, discrepancy: float) -> TurningPoints | None:
    """Those of one record, and how much larger the residual is about them; None where it is not."""
    if equations.averages is None:
        return None
    structure, time = equations.dynamics.structure, equations.target.physics_time
    rate = equations.flat_states(equations.physics, point).velocity
    rate = structure.elongation(equations.dynamics.stretching(rate))
    turning = torch.zeros(len(time), dtype=torch.bool, device=time.device)
    sticking = equations.problem.structure.groups
    for group, stuck, part in zip(structure.groups, sticking, structure.parts, strict=True):
        speed = group.nonlinearity.reversal_speed
        if group.nonlinearity is not stuck.nonlinearity and speed is not None:
            own = rate[:, part.connections]
            turning |= (own.abs() < STRAIGHT * speed).any(1)
            turning[1:] |= (own[1:] * own[:-1] < 0).any(1)
    assert isinstance(equations.network, SplineNetwork)
    turns = TurningPoints(time[turning].cpu().numpy(), 1.0, 1.0, discrepancy)
    near = turns.near(equations.averages.times(time), equations.network.spacing)
    square = equations.motion.residual(point)[:, 0, equations.dynamics.has_mass].square().mean(1).cpu().numpy()
    if not 0.0 < near.mean() < MOST:
        return None
    before, (level, other) = equations.problem.turning_points, (float(np.sqrt(square[x].mean())) for x in (near, ~near))
    if before is None:
        return replace(turns, level=level, looser=max(FIRST, level / other))
    return replace(turns, level=before.level, looser=before.level / other)
