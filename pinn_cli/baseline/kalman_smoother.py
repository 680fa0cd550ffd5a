"""Iterated extended Rauch-Tung-Striebel smoother: what one would pick instead of a network."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse import csr_matrix

from pinn_cli.baseline.iterated_smoother import IteratedSmoother, Pass, most_probable, stiffened, widened
from pinn_cli.baseline.state_space import ON_TIME, StateSpace
from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.network.network import States
from pinn_cli.physics import estimated_response
from pinn_cli.record.response import RESPONSE_QUANTITIES, Response
from pinn_cli.record.steps import has_stiff_law
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.settings.legal_values import fraction, positive_number, true_or_false, whole_number
from pinn_cli.system.parameters import FACTOR
from pinn_cli.training.estimate import Estimate, ParameterEstimate, RunContext
from pinn_cli.training.estimator import Estimator
from pinn_cli.training.noise_model import FoundNoise
from pinn_cli.training.reported.parameter_posterior import bounded_estimates


def smoothed_estimate(space: StateSpace, last: Pass, history: pd.DataFrame, summary: dict[str, Any]) -> Estimate:
    """Motion, forces and parameters of the last pass.

    What the motion needs beyond the measured force is the load cell's error or the model's. Under a load cell only the
    former belongs to the force that acts, in proportion to its variance; elsewhere all of it is reported, and shows on
    an unforced DOF where the model is wrong.
    """
    trajectory, levels = last.trajectory, last.levels
    equations = space.equations(space.parameters(trajectory))
    jet = equations.jet(trajectory.states, space.force + last.disturbances)
    motion = States(*jet, None)
    response = estimated_response(space.problem.record, space.dynamics, equations.parameters, motion, motion)
    share = 1.0 - np.where(space.measured, levels.discrepancy**2 / (space.sources @ levels.forces**2), 0.0)
    dofs = np.flatnonzero(space.measured)
    response.force[:, dofs] -= ((1.0 - share) * last.disturbances)[:, dofs]
    std = _deviations(space, last, response, share)
    summary, noise = summary | {"parameter_spread": levels.spread}, FoundNoise(discrepancy=levels.discrepancy)
    return Estimate(response, std, _parameters(space, last), history, summary, noise=noise)


class _Spread:
    """Standard deviations of sums of functions and their derivatives, under the posterior."""

    def __init__(self, last: Pass) -> None:
        self.covariance, self.by_coefficient = last.filtered.posterior()
        self.root = np.linalg.cholesky(last.regression.covariance)
        self.functions = last.linearised.functions

    def sensed(self, parts: Sequence[tuple[int, csr_matrix]]) -> np.ndarray:
        """(N, C), of sums (order of the derivative, (C, F) weights of the functions), see :meth:`Functions.sensing`."""
        rows = [weights.toarray() @ self.functions[order] for order, weights in parts]
        return self.of(np.sum(rows, axis=0))

    def of(self, rows: np.ndarray) -> np.ndarray:
        """(N, C), of rows (N, C, columns), see :class:`pinn_cli.baseline.equations.Equations`."""
        of_state, past = np.split(rows, [self.covariance.shape[1]], axis=2)  # what parameters do past the state
        variance = np.sum((of_state @ self.covariance) * of_state, axis=2)
        through = of_state @ self.by_coefficient
        through[:, :, : past.shape[2]] += past
        variance += np.sum((through @ self.root) ** 2, axis=2)
        return np.sqrt(variance.clip(min=0.0))


def _deviations(space: StateSpace, last: Pass, response: Response, share: np.ndarray) -> Response:
    spread, dynamics = _Spread(last), space.dynamics
    displacement, velocity, acceleration = (spread.sensed(dynamics.sensing(q)) for q in RESPONSE_QUANTITIES)
    values = spread.sensed([(0, dynamics.picked(slice(0, dynamics.size)))])
    force = np.zeros_like(response.force)
    if not dynamics.structure.is_modal:
        dofs = np.arange(force.shape[1])
        pushed = np.zeros((len(force), len(dofs), last.linearised.rows.shape[-1]))
        pushed[:, dofs, space.size + dofs] = share[dofs]
        # What the motion cannot tell: how the load cell's noise and the model error divide their sum.
        untold = (share * space.measured)[dofs] * last.levels.discrepancy**2
        force = np.sqrt(spread.of(pushed) ** 2 + untold)
    force[:, dynamics.loaded] = values[:, dynamics.acting]
    hidden = None if response.hidden is None else values[:, dynamics.hidden]
    return Response(response.time, displacement, velocity, acceleration, force, hidden=hidden)


def _parameters(space: StateSpace, last: Pass) -> list[ParameterEstimate]:
    """The smoother knows no bounds: they cut off afterwards what its Gaussian leaves below them."""
    uncertain, mean = space.problem.uncertain, last.trajectory.parameters
    unit = np.array([p.prior_std for p in uncertain])
    lower = np.array([p.lower for p in uncertain]) / unit
    covariance = last.regression.covariance[: len(uncertain), : len(uncertain)]
    return bounded_estimates(uncertain, unit, mean, TruncatedGaussian(mean, covariance, lower))


class KalmanSmoother(Estimator):
    """Smoothed states and parameters of the same model, from the same sensors (Sarkka 2013, chapter 10).

    Args:
        iterations: Passes at most under one noise level.
        tolerance: Part of the motion; a pass that moves it by less is the last.
        process_noise: Standard deviation of the force that the model leaves out, on every DOF, held from sample to
            sample, N; None: the most probable one, widened for its colour.
        learn_spread: Whether the common spread of the prescribed parameters is learned from the record.

    Raises:
        InputError: A setting outside its range.
    """

    name = "kalman_smoother"

    def __init__(
        self,
        iterations: int = 12,
        tolerance: float = 1e-4,
        process_noise: float | None = None,
        learn_spread: bool = True,
    ) -> None:
        self.iterations = whole_number("baseline.iterations", iterations, least=1)
        self.tolerance = fraction("baseline.tolerance", tolerance)
        self.learn_spread = true_or_false("baseline.learn_spread", learn_spread)
        self.process_noise = None if process_noise is None else positive_number("baseline.process_noise", process_noise)

    def check(self, problem: Problem) -> None:
        """See :meth:`Estimator.check`."""
        for refused, where, why in _refused(problem):
            if refused:
                raise InputError("baseline", self.name, f"none {where}", why)

    def solve(self, problem: JointProblem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`."""
        smoother = IteratedSmoother(StateSpace(problem.alone), self.iterations, self.learn_spread)
        try:
            levels = smoother.space.first_levels()
            if self.process_noise is None:
                best = widened(smoother, most_probable(smoother, levels))
            else:
                best = stiffened(smoother, levels, self.process_noise)
            last = smoother.settle(best.trajectory, best.levels, self.tolerance)
            summary = {
                "iterations": len(smoother.history),
                "stop_reason": "converged" if last.step < self.tolerance else "iteration limit",
                "log_evidence": last.regression.log_evidence,
            }
            return smoothed_estimate(smoother.space, last, pd.DataFrame(smoother.history), summary)
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise DivergenceError(str(error)) from error


def _refused(problem: Problem) -> Iterator[tuple[bool, str, str]]:
    """Whether there are no equations for a problem, where that is, and why."""
    record, structure = problem.record, problem.structure
    moves = bool(problem.inputs.ground or structure.supports)
    yield has_stiff_law(structure), "with friction that sticks", "it takes explicit steps; give it a speed"
    yield moves, "where the ground or a support moves", "it would copy the sensors of what they shake"
    yield problem.prior is not None, "with model=...", "it knows no correlated parameters"
    factors = any(p.kind == FACTOR for p in problem.uncertain)
    yield factors, "where factors of parts are in doubt", "its coordinates would stay what they are"
    for channel in record.calibrated:
        such = f"channel {channel.key} is such"
        yield not channel.number("delay").is_known, "where a delay is in doubt", such
        yield channel.filter_order > 0, "where a sensor is behind a filter", such
        sparse = (channel.even_step or math.inf) >= (1.0 + ON_TIME) * record.step
        between = sparse and np.abs(channel.places(record.time)[1]).max() > ON_TIME
        yield bool(between), "where samples lie between the record's times", such
