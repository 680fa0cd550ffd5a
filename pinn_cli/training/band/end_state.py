"""The state at the end of a record, with its covariance: what a record that goes on from there begins with."""

from __future__ import annotations

import numpy as np
import torch
from scipy.linalg import solve_triangular
from torch import Tensor

from pinn_cli.model.knowledge import EndState
from pinn_cli.training.band.record_evidence import RecordEvidence, RecordSolution


def end_state(evidence: RecordEvidence, solution: RecordSolution) -> EndState:
    """Displacements, velocities and hidden forces of the coordinates at the last sample.

    The rows touch the last features alone, so the triangular solve begins there.

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
    first = int(min(place.min() for place in places))
    size = equations.layout.size
    rows = np.zeros((size - first, len(wanted)))
    for column, (place, (_, phi)) in enumerate(zip(places, wanted, strict=True)):
        rows[place - first, column] = phi
    own, crossed = factor.readout.last_covariance(rows)
    through = solve_triangular(factor.schur, crossed, lower=True)
    unit = equations.scale.cpu().numpy()
    with_parameters = (-unit[:, None] * (factor.corner_covariance @ crossed))[: len(equations.problem.uncertain)]
    return EndState(
        float(equations.problem.record.time[-1]),
        rows.T @ _tail_of(solution.point.unknowns, first),
        own + through.T @ through,
        with_parameters.T,
    )


def _tail_of(unknowns: Tensor, first: int) -> np.ndarray:
    return torch.as_tensor(unknowns[first:]).cpu().numpy()
