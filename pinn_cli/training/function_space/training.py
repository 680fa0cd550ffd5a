"""Gauss-Newton training of a multilayer perceptron in function space, with inferred weights.

In function space the network is a Gaussian process whose kernel is that of its linearisation over the precision of its
weights, seen through residuals of unit variance, with the chain's parameters as regression coefficients. So one more
linearisation at the solution says how far parameters and motion are known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.network.base import NetworkDesign, States
from pinn_cli.network.embedding import BAND_MARGIN
from pinn_cli.network.mlp import Mlp
from pinn_cli.physics import physics_residual, targets
from pinn_cli.record.evenly_spaced import evenly_spaced
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.training.acting_force import acting_force
from pinn_cli.training.bounded_estimates import bounded_estimates
from pinn_cli.training.estimate import Estimate, ParameterEstimate, RunContext
from pinn_cli.training.function_space.collocation import collocate
from pinn_cli.training.function_space.kernel import Block, linearised
from pinn_cli.training.function_space.linearisation import Linearisation
from pinn_cli.training.function_space.residuals import ResidualRows
from pinn_cli.training.function_space.search import FunctionSpaceSearch
from pinn_cli.training.function_space.solution import Solution, follows_features
from pinn_cli.training.history import History
from pinn_cli.training.learned_parameters import LearnedParameters
from pinn_cli.training.network_response import network_response
from pinn_cli.training.record_scales import CONTINUITY_TOLERANCE, force_and_velocity_scale
from pinn_cli.training.stepwise import train

# Times at which standard deviations are computed; between them they change slowly.
TIMES = 96


class FunctionSpacePosterior:
    """Of a training that has ended.

    Args:
        search: At its solution.

    Raises:
        DivergenceError: The normal matrix there is singular.

    Attributes:
        noise: That of the search, its discrepancy widened for its colour: a model error that fills a part of the band
            has fewer independent values, and larger ones, than there are points.
        covariance: (p, p), of the uncertain parameters, in prior standard deviations: the motion integrated out, and
            what misfit may have added to each (:func:`pinn_cli.training.reported.parameter_posterior.coherent_misfit`).
    """

    def __init__(self, search: FunctionSpaceSearch) -> None:
        self.search, self.precision = search, search.precision
        self.columns = search.parameters.uncertain
        self.unit = search.parameters.prior_deviation
        self.noise = search.noise.widened(self._occupied())
        self.linear = Linearisation(search.network, search.parameters, search.rows, self.noise)
        self.system = search.solution.for_bands(self.linear, self.precision, [self._acting()])
        self.covariance = self.system.parameter_covariance + self._coherent_misfit().square().diag()

    def _acting(self) -> Block:
        """The force that the motion takes, on all DOFs, at the points where physics is enforced."""
        return linearised(self.search.network, self.linear.time, self._force)[0]

    def _force(self, states: States) -> Tensor:
        structure = self.search.rows.structure
        return structure.external_force(states.displacement, states.velocity, states.acceleration, self._values()).T

    @torch.no_grad()
    def _occupied(self) -> float:
        """Share of the band that the forces out of balance fill."""
        search, target = self.search, self.search.rows.target
        states = search.network(target.physics_time)
        residual = physics_residual(states, target, search.rows.dynamics, self._values())
        enforced = target.unforced if bool(target.unforced.any()) else target.equation
        step = float(target.physics_time[1] - target.physics_time[0])
        top = min(0.5 / step, BAND_MARGIN * search.network.cycles / search.network.span)
        return occupied_band(residual[:, enforced].cpu().numpy(), step, top)

    @torch.no_grad()
    def _coherent_misfit(self) -> Tensor:
        """(p,), in prior standard deviations, what the model leaves out and each parameter may have taken in."""
        search, target = self.search, self.search.rows.target
        states = search.network(target.physics_time)
        force = search.rows.own_by_parameter(self.columns, states, self._values()) * self.unit
        own = force.square().mean(0).sqrt()
        hidden = self.noise.misfit(1, 1) / own.clamp(min=torch.finfo(own.dtype).tiny)
        return hidden / torch.hypot(torch.ones_like(hidden), hidden)

    def std(self, observation_time: Tensor, physics_time: Tensor, time: np.ndarray) -> Response:
        """Standard deviations of every quantity, (N, n).

        Args:
            observation_time: (N,), when motions are asked for, s.
            physics_time: (N,), when forces are.
            time: (N,), the record's.
        """
        samples = evenly_spaced(len(time), min(TIMES, len(time)))

        def motion(states: States) -> Tensor:
            return torch.cat((states.displacement.T, states.velocity.T, states.acceleration.T))

        network = self.search.network
        moved, _, _ = linearised(network, observation_time[samples], motion)
        acting, _, states = linearised(network, physics_time[samples], self._force)
        by_parameter = self.search.rows.force_by_parameter(self.columns, states, self._values()) * self.unit
        of_motion = self._variance(moved, torch.zeros(moved.size, len(self.columns)).to(by_parameter))
        of_force = self._variance(acting, by_parameter.transpose(0, 1).flatten(0, 1))
        rows = torch.cat((of_motion, of_force)).clamp(min=0.0).sqrt().cpu().numpy()
        every = np.array([np.interp(time, time[samples], row) for row in rows]).reshape(len(QUANTITIES), -1, len(time))
        return Response(time, *(quantity.T for quantity in every))

    def _variance(self, block: Block, by_parameter: Tensor) -> Tensor:
        """(R, P): with the parameters known, and what not knowing them adds."""
        known, following = self.system.explained(block)
        sensitivity = by_parameter - following
        unknown = ((sensitivity @ self.covariance) * sensitivity).sum(1)
        return (known + unknown).view(block.rows, -1)

    def _values(self) -> Mapping[str, Tensor]:
        return {name: value.detach() for name, value in self.search.parameters().items()}


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
            raise InputError("training", "gauss_newton", "adam or lbfgs for this network", hint)
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
