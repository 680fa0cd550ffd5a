"""From the last pass of the smoother to what is reported: means, standard deviations and parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.baseline.iterated_smoother import Pass
from pinn_cli.baseline.state_space import StateSpace
from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.record.response import Response
from pinn_cli.training.bounded_estimates import bounded_estimates
from pinn_cli.training.estimate import Estimate, ParameterEstimate


class _Spread:
    """Standard deviations of linear functions of state, disturbance and coefficients, under the posterior."""

    def __init__(self, last: Pass) -> None:
        self.covariance, self.by_coefficient = last.filtered.posterior()
        self.root = np.linalg.cholesky(last.regression.covariance)

    def of(self, rows: np.ndarray, by_coefficient: np.ndarray | None = None) -> np.ndarray:
        """(N, n) of rows (N, n, s + d); ``by_coefficient`` (N, n, p): what coefficients do past the state."""
        variance = np.sum((rows @ self.covariance) * rows, axis=2)
        through = rows @ self.by_coefficient
        if by_coefficient is not None:
            through[:, :, : by_coefficient.shape[2]] += by_coefficient
        variance += np.sum((through @ self.root) ** 2, axis=2)
        deviation: np.ndarray = np.sqrt(variance.clip(min=0.0))
        return deviation


def smoothed_estimate(space: StateSpace, last: Pass, history: pd.DataFrame, summary: dict[str, Any]) -> Estimate:
    """Motion, forces and parameters of the last pass.

    What the motion needs beyond the measured force is the load cell's error or the model's. Under a load cell only the
    former belongs to the force that acts, in proportion to its variance; elsewhere all of it is reported, and shows on
    an unforced DOF where the model is wrong.
    """
    record, trajectory = space.problem.record, last.trajectory
    u, v, hidden, _ = space.split(trajectory.states)
    sensor = np.nan_to_num(last.levels.force) ** 2
    share = np.where(record.sensors("force"), sensor / last.levels.disturbance_variance, 1.0)
    acceleration = space.acceleration(trajectory) + last.disturbances / space.parameters(trajectory)["m"]
    force = space.loads.at_samples(space.parameters(trajectory)) + share * last.disturbances
    force[:, space.hidden] += hidden
    return Estimate(
        Response(record.time, u, v, acceleration, force),
        _deviations(space, last, share),
        _parameters(space, last),
        history,
        summary | {"sigma_discrepancy": last.levels.discrepancy, "parameter_spread": last.levels.spread},
    )


def _deviations(space: StateSpace, last: Pass, share: np.ndarray) -> Response:
    record, n, s = space.problem.record, space.n, space.size
    spread, linearised = _Spread(last), last.linearised
    samples, identity = len(record.time), np.eye(s + n)
    by_state, mass = linearised.by_state, space.parameters(linearised.trajectory)["m"]
    felt = np.broadcast_to(np.diag(1.0 / mass), (samples, n, n))
    pushed = np.concatenate((np.zeros((n, s)), np.diag(share)), axis=1)
    pushed[space.hidden, 2 * n + np.arange(len(space.hidden))] = 1.0
    everywhere = (samples, n, s + n)
    told = space.loads.by_numbers(space.parameters(linearised.trajectory), space.problem.uncertain)
    force = spread.of(np.broadcast_to(pushed, everywhere), told)
    # What the motion cannot tell: how the load cell's noise and the model error divide their sum.
    force = np.sqrt(force**2 + share * last.levels.discrepancy**2 * record.sensors("force"))
    return Response(
        record.time,
        spread.of(np.broadcast_to(identity[:n], everywhere)),
        spread.of(np.broadcast_to(identity[n : 2 * n], everywhere)),
        spread.of(np.concatenate((by_state, felt), axis=2), linearised.by_parameter),
        force,
    )


def _parameters(space: StateSpace, last: Pass) -> list[ParameterEstimate]:
    """The smoother knows no bounds: they cut off afterwards what its Gaussian leaves below them."""
    uncertain, mean = space.problem.uncertain, last.trajectory.parameters
    unit = np.array([p.prior_std for p in uncertain])
    lower = np.array([p.lower for p in uncertain]) / unit
    covariance = last.regression.covariance[: len(uncertain), : len(uncertain)]
    return bounded_estimates(uncertain, unit, mean, TruncatedGaussian(mean, covariance, lower))
