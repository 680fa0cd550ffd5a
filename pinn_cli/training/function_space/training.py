"""Gauss-Newton training of a multilayer perceptron in function space, with inferred weights.

In function space the network is a Gaussian process whose kernel is that of its linearisation over the precision of its
weights, seen through residuals of unit variance, with the chain's parameters as regression coefficients. So one more
linearisation at the solution says how far parameters and motion are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.network.linear_readout import LinearReadout, Segments
from pinn_cli.network.mlp import BAND_MARGIN, Mlp
from pinn_cli.network.network import NetworkDesign
from pinn_cli.network.spline import Spline
from pinn_cli.physics import Targets, estimated_response, targets
from pinn_cli.record.between_samples import evenly_spaced
from pinn_cli.record.channels import record_band
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.training.estimate import Estimate, ParameterEstimate, RunContext
from pinn_cli.training.function_space.equations import NetworkEquations
from pinn_cli.training.function_space.feature_system import follows_features
from pinn_cli.training.function_space.network_frame import NetworkFrame, each_of
from pinn_cli.training.function_space.search import FunctionSpaceSearch
from pinn_cli.training.history import History, train
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import FeatureProjection, FoundNoise, NoiseLevels, NoiseModel
from pinn_cli.training.record_scales import CONTINUITY_TOLERANCE, force_and_velocity_scale
from pinn_cli.training.reported.parameter_posterior import bounded_estimates
from pinn_cli.training.reported.posterior_estimate import acting_force
from pinn_cli.training.steps.first_solution import inferred_sensor_noise

# Times at which standard deviations are computed; between them they change slowly.
TIMES = 96
# Fraction of the force that acts at which the physics begins: soft, so that the first steps are nearly linear.
SOFT = 0.1
# Precision of the weights at which training begins, over the square of the readout's gain; it follows the weights by
# factors of ten at most.
FIRST_PRECISION = 100.0
MOST_RESIDUALS = 8000


class FunctionSpacePosterior:
    """Of a training that has ended.

    Raises:
        DivergenceError: The normal matrix there is singular.

    Attributes:
        covariance: (p, p), of the uncertain parameters, in prior standard deviations: the motion integrated out, and
            what misfit may have added to each (:func:`pinn_cli.training.reported.parameter_posterior.coherent_misfit`).
    """

    def __init__(self, search: FunctionSpaceSearch) -> None:
        self.frame, self.point = search.equations.frame, search.point
        # A model error that fills a part of the band has fewer independent values, and larger ones, than points.
        widened = search.model.widened(self._occupied())
        levels = NoiseLevels((widened,), search.noise.spread)
        linear, self.unit = search.equations.assemble(self.point, levels).linear, search.equations.deviation(levels)
        acting = self.frame.linearised(self.frame.physics, self.point, self._force(self.frame.physics))[0]
        self.system = search.equations.for_bands(linear, [acting])
        self.covariance = self.system.parameter_covariance + self._coherent_misfit(widened).square().diag()

    def _coherent_misfit(self, noise: NoiseModel) -> Tensor:
        """(p,), in prior standard deviations, what the model leaves out and each parameter may have taken in."""
        if not self.frame.uncertain:
            return self.unit
        slopes = self.frame.motion.own_by_parameter(self.frame.physics, self.point)[0][:, self.frame.vector.column]
        rms = slopes.square().mean(0).sqrt() * self.unit
        hidden = noise.misfit(1, 1) / rms.clamp(min=torch.finfo(rms.dtype).tiny)
        return hidden / torch.hypot(torch.ones_like(hidden), hidden)

    @torch.no_grad()
    def _occupied(self) -> float:
        """Share of the band that the forces out of balance fill."""
        frame, network = self.frame, self.frame.perceptron
        residual = frame.motion.residual(Point(self.point.unknowns, self.point.parameters))[0]
        enforced = frame.target.unforced if bool(frame.target.unforced.any()) else frame.target.equation
        step = float(frame.target.physics_time[1] - frame.target.physics_time[0])
        top = min(0.5 / step, BAND_MARGIN * network.cycles / network.span)
        return occupied_band(residual[:, enforced].cpu().numpy(), step, top)

    def _force(self, segments: Segments) -> Callable[[Point], Tensor]:
        """(P, n), the force that the motion takes, on all DOFs."""
        frame = self.frame
        return lambda point: frame.dynamics.external_force(frame.jet(segments, point), frame.parameters(point))[0]

    def _motion(self, segments: Segments) -> Callable[[Point], Tensor]:
        return lambda point: torch.cat(self.frame.jet(segments, point), -1)[0]

    def std(self, observation_time: Tensor, physics_time: Tensor, time: np.ndarray) -> Response:
        """Standard deviations of every quantity, (N, n).

        Args:
            observation_time: (N,), when motions are asked for, s.
            physics_time: (N,), when forces are.
            time: (N,), the record's.
        """
        samples = evenly_spaced(len(time), min(TIMES, len(time)))
        moves, acts = self.frame.at(observation_time[samples]), self.frame.at(physics_time[samples])
        variance = torch.cat([self._variance(moves, self._motion(moves)), self._variance(acts, self._force(acts))])
        rows = variance.clamp(min=0.0).sqrt().cpu().numpy()
        deviations = np.array([np.interp(time, time[samples], row) for row in rows]).reshape(
            len(QUANTITIES), -1, len(time)
        )
        return Response(time, *(quantity.T for quantity in deviations))

    def _variance(self, segments: Segments, quantities: Callable[[Point], Tensor]) -> Tensor:
        """(R, P): with the parameters known, and what not knowing them adds."""
        block, _, by_parameter = self.frame.linearised(segments, self.point, quantities)
        held, following = self.system.explained(block)
        sensitivity = by_parameter.flatten(0, 1) * self.unit - following
        unknown = ((sensitivity @ self.covariance) * sensitivity).sum(1)
        return (held + unknown).view(block.rows, -1)


def solved_in_function_space(
    problem: JointProblem,
    design: NetworkDesign,
    run: RunContext,
    iterations: int | None,
    tolerance: float | None,
    learn_spread: bool,
    points: int | None,
    most_residuals: int,
) -> Estimate:
    """Damped Gauss-Newton over all weights and physical parameters, with noise levels inferred from the record.

    The curvature is the Gauss-Newton matrix of all residuals, solved in the space of the residuals (see
    :mod:`pinn_cli.training.function_space`), so that its cost hardly depends on the number of weights.

    Args:
        problem: Of one record.
        design: Of the network.
        run: Seed, device and who watches.
        iterations: Steps at most; None: 40.
        tolerance: Relative decrease of the loss below which training has converged, once the noise levels have settled;
            None: 0.02.
        learn_spread: Whether the common spread of the prescribed parameters is learned from the record.
        points: At which sensors and equations of motion are compared; None: as many as the record has independent
            values.
        most_residuals: For which the whole matrix of a step is made: its square is the memory, its cube the time. It
            bounds the points of networks that need it, see
            :func:`pinn_cli.training.function_space.feature_system.follows_features`.
    """
    if not isinstance(design, Mlp):
        hint = f"network={design.name} has neither a linear readout nor layers"
        raise InputError("training", "gauss_newton", "adam or lbfgs for this network", hint)
    alone = problem.alone
    all_targets = targets(alone.record, alone.dynamics, run.device)
    most = None if follows_features(design.build(alone.record)) else most_residuals
    collocation = collocate(alone, all_targets, points, most)
    network = design.build(alone.record, torch.float64, points=len(collocation.target.physics_time))
    network.reset(run.seed)
    gain = network.make_nearly_linear()
    frame = NetworkFrame(network.to(run.device), alone, collocation.target)
    force, velocity = force_and_velocity_scale(alone)
    noise = collocation.noise_model(SOFT * force, CONTINUITY_TOLERANCE * velocity)
    equations = NetworkEquations(frame, FIRST_PRECISION * gain**2, most_residuals)
    steps = iterations or 40
    with History(run.progress, run.watch, iterations=steps) as history:
        limits = steps, tolerance or 0.02
        search = FunctionSpaceSearch(equations, noise, force, *limits, learn_spread, history)
        train(search, run)
    response = acting_force(_response(search, all_targets), collocation.filtered_force, search.model)
    posterior = FunctionSpacePosterior(search)
    std = posterior.std(all_targets.observation_time, all_targets.physics_time, alone.record.time)
    estimates, correlation = _parameters(search, posterior)
    summary = _summary(search) | {"device": run.device}
    found_noise = FoundNoise(discrepancy=search.noise.discrepancy)
    return Estimate(response, std, estimates, history.table(), summary, correlation, noise=found_noise)


@torch.no_grad()
def _response(search: FunctionSpaceSearch, all_targets: Targets) -> Response:
    """Motion and force at all the record's samples."""
    frame, point = search.equations.frame, search.point
    states = (frame.states(frame.at(time), point) for time in (all_targets.observation_time, all_targets.physics_time))
    observed, enforced = (each_of(group, lambda history: history[0]) for group in states)
    return estimated_response(frame.problem.record, frame.dynamics, frame.parameters(point), observed, enforced)


def _parameters(
    search: FunctionSpaceSearch, posterior: FunctionSpacePosterior
) -> tuple[list[ParameterEstimate], np.ndarray | None]:
    """Estimates with what bounds leave of the Gaussian at the solution, weights integrated out."""
    frame = search.equations.frame
    if not frame.uncertain:
        return [], None
    unit, deviation = frame.scale.cpu().numpy(), posterior.unit.cpu().numpy()
    mode, covariance = search.point.parameters.cpu().numpy(), posterior.covariance.cpu().numpy()
    cut_off = TruncatedGaussian(mode, covariance * np.outer(deviation, deviation), frame.lower)
    std = np.sqrt(covariance.diagonal())
    return bounded_estimates(frame.uncertain, unit, mode, cut_off), covariance / np.outer(std, std)


def _summary(search: FunctionSpaceSearch) -> dict[str, Any]:
    equations = search.equations
    return {
        "iterations": search.iteration,
        "stop_reason": search.stop_reason,
        "loss": sum(search.losses().values()),
        "network_weights": len(search.point.unknowns),
        "collocation_points": len(equations.frame.target.physics_time),
        "solution": "dense" if equations.dense else "features",
        "parameter_spread": search.noise.spread,
        "weight_precision": equations.precision,
    }


# Points per period of the record's band; below that a motion between the points is seen by nothing.
FEWEST_PER_PERIOD = 2.5


@dataclass(frozen=True, eq=False)
class Collocation:
    """Targets at P points and the noise that they carry.

    Attributes:
        target: Its histories are (P, n).
        response: Quantity to the standard deviation of its noise at the points, (n,), NaN where there is no sensor.
        force: The same of the force sensors.
        filtered_force: (N, n), the measured forces at every sample, low-passed.
    """

    target: Targets
    response: dict[str, np.ndarray]
    force: np.ndarray
    filtered_force: np.ndarray

    def noise_model(self, discrepancy: float, continuity: float) -> NoiseModel:
        """Of the residuals at the points."""
        return NoiseModel(self.response, self.force, discrepancy, continuity)


def collocate(problem: Problem, all_targets: Targets, points: int | None, most_rows: int | None) -> Collocation:
    """The record at ``points`` uniform samples, low-passed to what a spline of its band can follow.

    Args:
        problem: Structure and record.
        all_targets: The record's targets at all its samples.
        points: P; None: as many as the spline has features, but no more than ``most_rows`` residuals in all.
        most_rows: See ``points``; None: any number.

    Raises:
        InputError: Too few points for the record's band, or the most rows allow no more.
    """
    record, target = problem.record, all_targets
    network = Spline().build(record)
    response, force = inferred_sensor_noise(problem)
    count = _points(problem, points, most_rows, network.count)
    samples = torch.as_tensor(evenly_spaced(len(record.time), count), device=all_targets.force.device)
    if network.count < len(record.time):
        target = _low_passed(target, network)
        kept = math.sqrt(network.count / len(record.time))
        response, force = {q: kept * sigma for q, sigma in response.items()}, kept * force
    return Collocation(target.at(samples), response, force, target.force.cpu().numpy())


def _points(problem: Problem, points: int | None, most_rows: int | None, features: int) -> int:
    record = problem.record
    available, band = len(record.time), record_band(record)
    least = min(available, math.ceil(FEWEST_PER_PERIOD * band * record.duration))
    channels = sum(int(record.sensors(quantity).sum()) for quantity in RESPONSE_QUANTITIES) + record.ndof
    if points is None:
        points = min(features, available)
        points = points if most_rows is None else min(points, max(least, most_rows // channels))
    points = min(points, available)
    if points < least:
        hint = f"the record goes up to {band:.3g} Hz and lasts {record.duration:.4g} s"
        raise InputError("training.collocation_points", points, f"a whole number >= {least}, or null", hint)
    return points


def _low_passed(target: Targets, network: LinearReadout) -> Targets:
    segments = network.segments(target.observation_time.cpu())

    def smooth(values: Tensor, order: int) -> Tensor:
        rest = FeatureProjection(network, segments, order).residual(values.cpu())
        return values - torch.as_tensor(rest).to(values)

    response = {
        quantity: smooth(target.response[quantity], order) for order, quantity in enumerate(RESPONSE_QUANTITIES)
    }
    return replace(
        target, response=response, force=smooth(target.force, 0), observer_force=smooth(target.observer_force, 0)
    )
