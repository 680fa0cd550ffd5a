"""The score of another model of damping at a solution: a step of its normal equations, see `other_damping`."""

from __future__ import annotations

import numpy as np
import torch

from pinn_cli.training.doubts.other_damping import DampingDoubt, damping_doubt, with_other_damping
from pinn_cli.training.point import Point
from pinn_cli.training.solver import Inference


def scored_damping(inference: Inference) -> DampingDoubt | None:
    """What the record of a solution says of another model of damping; None where it is not asked."""
    equations, point = inference.by_record[0]
    if equations.known_parameters is not None:
        return equations.known_parameters.damping_doubt
    problem, trained = inference.evidence.problem, inference.trained
    if problem.has_unknown_forces:  # that nobody measured: they are free to be whatever damping is not
        return None
    values = {kind: x.numpy() for kind, x in equations.parameters(point).items()}
    extended = with_other_damping(problem, values)
    if extended is None:
        return None
    networks = [record_equations.network for record_equations in inference.evidence.equations.by_record]
    evidence = inference.solver.evidence(extended, networks)
    points = []
    for (record_equations, at), more in zip(inference.by_record, evidence.equations.by_record, strict=True):
        by_parameter = dict(zip(record_equations.uncertain, at.parameters, strict=True))
        distances = [by_parameter.get(p, at.parameters.new_zeros(())) for p in more.uncertain]
        points.append(Point(more.layout.unknowns(record_equations.layout.weights(at.unknowns)), torch.stack(distances)))
    joint = evidence.equations
    joint.share_ridges(inference.evidence.equations)
    start = joint.joined(points)
    system = joint.assemble(start, trained.noise)
    factor = system.factor()
    if factor is None:
        return None
    _, step = factor.step(system)
    # What the others gain by themselves is not theirs: at the marginal peak these stand beside the likeliest place.
    added = np.flatnonzero([p not in inference.evidence.equations.uncertain for p in joint.uncertain])
    by, covariance = step[added], factor.corner_covariance[np.ix_(added, added)]
    log_odds = 0.5 * float(by @ np.linalg.solve(covariance, by) + np.linalg.slogdet(covariance)[1])
    scale, first = joint.scale, start.parameters.numpy()
    moved = scale * first, scale * (first + step)
    return damping_doubt(problem, extended, joint.uncertain, moved, log_odds)
