"""Gauss-Newton training of a multilayer perceptron in function space, with inferred weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.network.base import NetworkDesign
from pinn_cli.network.mlp import Mlp
from pinn_cli.physics import targets
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.training.acting_force import acting_force
from pinn_cli.training.bounded_estimates import bounded_estimates
from pinn_cli.training.estimate import Estimate, ParameterEstimate, RunContext
from pinn_cli.training.function_space.collocation import collocate
from pinn_cli.training.function_space.posterior import FunctionSpacePosterior
from pinn_cli.training.function_space.residuals import ResidualRows
from pinn_cli.training.function_space.search import FunctionSpaceSearch
from pinn_cli.training.function_space.solution import Solution, follows_features
from pinn_cli.training.history import History
from pinn_cli.training.learned_parameters import LearnedParameters
from pinn_cli.training.network_response import network_response
from pinn_cli.training.record_scales import CONTINUITY_TOLERANCE, force_and_velocity_scale
from pinn_cli.training.stepwise import train

# Fraction of the force that acts at which the physics begins: soft, so that the first steps are nearly linear.
SOFT = 0.1
# Precision of the weights at which training begins, over the square of the readout's gain; it follows the weights by
# factors of ten at most.
FIRST_PRECISION = 100.0


MOST_RESIDUALS = 8000


@dataclass(frozen=True)
class FunctionSpaceGaussNewton:
    """Levenberg-Marquardt over all weights and physical parameters, with noise levels inferred from the record.

    The curvature is the Gauss-Newton matrix of all residuals, solved in the space of the residuals (see
    :mod:`pinn_cli.training.function_space`), so that its cost hardly depends on the number of weights.

    Attributes:
        iterations: Steps at most.
        tolerance: Relative decrease of the loss below which training has converged, once the noise levels have settled.
        learn_spread: Whether the common spread of the prescribed parameters is learned from the record.
        collocation_points: Points at which sensors and equations of motion are compared; None: as many as the record
            has independent values.
        most_residuals: For which the whole matrix of a step is made: its square is the memory, its cube the time. It
            bounds the points of networks that need it, see
            :func:`pinn_cli.training.function_space.solution.follows_features`.
    """

    iterations: int = 40
    tolerance: float = 0.02
    learn_spread: bool = True
    collocation_points: int | None = None
    most_residuals: int = MOST_RESIDUALS

    def solve(self, problem: JointProblem, design: NetworkDesign, run: RunContext) -> Estimate:
        """See :meth:`pinn_cli.training.base.Training.solve`."""
        if not isinstance(design, Mlp):
            hint = f"network={design.name} has neither a linear readout nor layers"
            raise InputError("training", "gauss_newton", "adam, lbfgs or ssbroyden for this network", hint)
        own = problem.alone
        every = targets(own.record, own.dynamics, run.device)
        most = None if follows_features(design.build(own.record)) else self.most_residuals
        collocation = collocate(own, every, self.collocation_points, most)
        network = design.build(own.record, torch.float64, points=len(collocation.target.physics_time))
        network.reset(run.seed)
        gain = network.make_nearly_linear()
        network.to(run.device)
        parameters = LearnedParameters(own, torch.float64).to(run.device)
        rows = ResidualRows(
            own.dynamics, collocation.target, own.acceleration_through, network.continuity == "penalised",
            own.initial_deviation,
        )  # fmt: skip
        force, velocity = force_and_velocity_scale(own)
        noise = collocation.noise_model(SOFT * force, CONTINUITY_TOLERANCE * velocity)
        with History(run.progress, run.watch, iterations=self.iterations) as history:
            search = FunctionSpaceSearch(
                network, parameters, rows, noise, FIRST_PRECISION * gain**2, force, self.iterations, self.tolerance,
                self.learn_spread, history, Solution(network, self.most_residuals),
            )  # fmt: skip
            train(search, run)
        response = network_response(own, every, network, parameters)
        response = acting_force(response, collocation.filtered_force, search.noise)
        posterior = FunctionSpacePosterior(search)
        std = posterior.std(every.observation_time, every.physics_time, own.record.time)
        estimates, correlation = _parameters(search, posterior)
        return Estimate(response, std, estimates, history.table(), _summary(search), correlation)


def _parameters(
    search: FunctionSpaceSearch, posterior: FunctionSpacePosterior
) -> tuple[list[ParameterEstimate], np.ndarray | None]:
    """Estimates with what bounds leave of the Gaussian at the solution, weights integrated out."""
    parameters = search.parameters
    if not parameters.uncertain:
        return [], None
    unit = parameters.unit.cpu().numpy()
    deviation = (parameters.prior_deviation / parameters.unit).cpu().numpy()
    mode, lower = parameters.moved.detach().cpu().numpy(), parameters.lower.cpu().numpy()
    covariance = posterior.covariance.cpu().numpy()
    cut_off = TruncatedGaussian(mode, covariance * np.outer(deviation, deviation), lower)
    std = np.sqrt(covariance.diagonal())
    return bounded_estimates(parameters.uncertain, unit, mode, cut_off), covariance / np.outer(std, std)


def _summary(search: FunctionSpaceSearch) -> dict[str, Any]:
    noise = search.noise
    return {
        "iterations": search.iteration,
        "stop_reason": search.stop_reason,
        "loss": search.loss().total,
        "network_weights": sum(weight.numel() for weight in search.network.parameters()),
        "collocation_points": search.rows.points,
        "solution": "dense" if search.solution.dense else "features",
        "sigma_discrepancy": noise.discrepancy,
        "parameter_spread": search.parameters.spread,
        "weight_precision": search.precision,
    }
