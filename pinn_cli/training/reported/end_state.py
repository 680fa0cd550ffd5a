"""The state at the end of a record, with its covariance: what a record that goes on from there begins with."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from pinn_cli.model.knowledge import EndState
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution


def end_state(evidence: RecordEvidence, solution: RecordSolution) -> EndState:
    """Displacements, velocities and hidden forces of the coordinates at the last sample.

    Args:
        evidence: Of one record.
        solution: Its part of a solution; the factor may know of parameters from other records as well.
    """
    equations, factor = evidence.equations, solution.factor
    dynamics, time = equations.dynamics, equations.target.observation_time
    segments = equations.network.segments(time[-1:])
    alive = segments.mask[:, 0] > 0
    feature = segments.feature[alive][0].cpu().numpy()
    value, rate = (x[alive][0, 0].cpu().numpy() for x in (segments.displacement, segments.velocity))
    motion, hidden = np.arange(dynamics.ndof), np.arange(dynamics.size)[dynamics.hidden]
    wanted = [(function, phi) for phi, own in ((value, motion), (rate, motion), (value, hidden)) for function in own]
    places = [equations.layout.positions(feature, np.full(len(feature), function)) for function, _ in wanted]
    rows = np.zeros((equations.layout.size, len(wanted)))
    for column, (place, (_, phi)) in enumerate(zip(places, wanted, strict=True)):
        rows[place, column] = phi
    half, crossed = factor.readout.half_solved(rows)
    through = solve_triangular(factor.schur, crossed, lower=True)
    unit = equations.scale.cpu().numpy()
    with_parameters = (-unit[:, None] * (factor.corner_covariance @ crossed))[: len(equations.problem.uncertain)]
    return EndState(
        float(equations.problem.record.time[-1]),
        rows.T @ solution.point.unknowns.cpu().numpy(),
        half.T @ half + through.T @ through,
        with_parameters.T,
    )
