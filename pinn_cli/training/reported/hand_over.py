"""What is known where a later record goes on: from the samples up to that time, and from no later ones.

A record may overlap the next one, whose samples are then in both. Knowledge that has taken them in already would count
them twice. So the solution is taken once more from the samples before the hand-over alone, under the noise that all of
them tell: the same knots as far as they reach, from where the solution is, which takes one step or two.

The state at the end of a record, with its covariance: what a record that goes on from there begins with.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from scipy.linalg import solve_triangular

from pinn_cli.model.knowledge import EndState, HandOver
from pinn_cli.network.spline import SplineNetwork
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.minimise import Point
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.reported.parameter_posterior import coherent_misfit, parameter_force, parameter_posterior
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.known_levels import softer_point


def end_state(evidence: RecordEvidence, solution: RecordSolution) -> EndState:
    """Displacements, velocities and hidden forces of the coordinates at the last sample.

    The solution's factor may know of parameters from other records as well.
    """
    equations, factor = evidence.equations, solution.factor
    dynamics, time = equations.dynamics, equations.target.observation_time
    segments = equations.network.segments(time[-1:])
    alive = segments.mask[:, 0] > 0
    feature = segments.feature[alive][0].numpy()
    value, rate = (x[alive][0, 0].numpy() for x in segments.orders[:2])
    motion, hidden = np.arange(dynamics.ndof), np.arange(dynamics.size)[dynamics.hidden]
    wanted = [(value, i) for i in motion] + [(rate, i) for i in motion] + [(value, i) for i in hidden]
    rows = np.zeros((equations.layout.size, len(wanted)))
    for column, (phi, function) in enumerate(wanted):
        rows[equations.layout.positions(feature, np.full(len(feature), function)), column] = phi
    half, crossed = factor.readout.half_solved(rows)
    through = solve_triangular(factor.schur, crossed, lower=True)
    unit = equations.scale.numpy()
    with_parameters = (-unit[:, None] * (factor.corner_covariance @ crossed))[: len(equations.problem.uncertain)]
    return EndState(
        float(equations.problem.record.time[-1]),
        rows.T @ solution.point.unknowns.numpy(),
        half.T @ half + through.T @ through,
        with_parameters.T,
    )


def handed_over(inference: Inference) -> HandOver:
    """Parameters and state at :attr:`pinn_cli.scheme.problem.Problem.hand_over`, from the solution of all samples.

    Raises:
        DivergenceError: The samples before that time have no solution.
    """
    equations, problem = inference.evidence.equations.by_record[0], inference.evidence.problem.alone
    assert problem.hand_over is not None
    network, record = equations.network, problem.record
    assert isinstance(network, SplineNetwork)
    samples = int(np.searchsorted(record.time, problem.hand_over + 0.5 * record.step))
    early = replace(problem, record=record.until(samples))
    # Beyond its last sample a record has as much of an interval as before its first one.
    margin = float(record.time[0]) - network.start
    intervals = math.ceil((float(early.record.time[-1]) + margin - network.start) / network.spacing - 1e-6)
    shorter = SplineNetwork(
        network.ndof, network.start, network.start + intervals * network.spacing, intervals, network.degree,
        network.continuity, network.readout.dtype,
    )  # fmt: skip
    evidence = inference.solver.evidence(JointProblem.of(early), [shorter])
    point = inference.trained.solution.point
    start = Point(point.unknowns[: evidence.equations.by_record[0].layout.size], point.parameters)
    if early.uncertain:
        start = softer_point(evidence, inference.trained.noise, start)
    trained = evidence.train(inference.trained.noise, start)
    if trained is None or not torch.isfinite(trained.solution.point.unknowns).all():
        raise DivergenceError(f"the samples up to {problem.hand_over:g} s alone have no solution to hand over")
    hidden = coherent_misfit(evidence.equations.columns, evidence.each_record(parameter_force, trained))
    _, _, known = parameter_posterior(evidence.equations, trained, hidden)
    (end,) = evidence.each_record(end_state, trained)
    return HandOver(known, end, inference.discrepancy)
