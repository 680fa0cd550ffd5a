"""How probable a record is under a noise model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import torch

from pinn_cli.network.linear_readout import Segments
from pinn_cli.network.spline import SplineNetwork
from pinn_cli.physics import observation_masks
from pinn_cli.record.gauge import GAUGE
from pinn_cli.record.spectrum import occupied_band, visible_floor
from pinn_cli.training.band.bordered import BorderedFactor
from pinn_cli.training.band.discrepancy_search import DiscrepancySearch, Trained
from pinn_cli.training.band.force_residuals import ForceResiduals
from pinn_cli.training.band.motion_density import log_density, seen_powers
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Point
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel, first_output, output_features

R = TypeVar("R")

# Losses that are about the parameters alone.
OF_PARAMETERS = ("prior", "gain", "marginal")


class Evidence(DiscrepancySearch):
    """Laplace approximation of the marginal likelihood of a noise model (MacKay 1992), everything integrated out.

    Readout and parameters are integrated out. The physics residual counts as what the features can see of it, K values
    per DOF with a discrepancy that is white among them; beyond that there is nothing but the force sensors' noise.

    Attributes:
        problem: Of the record.
        records: The evidence of every record: this one.
    """

    def __init__(
        self,
        equations: NormalEquations,
        iterations: int,
        tolerance: float,
        watch: Callable[[dict[str, float], NoiseModel], None],
        learn_spread: bool = True,
        count: Callable[[int], None] = lambda factorisations: None,
    ) -> None:
        super().__init__(equations, iterations, tolerance, watch, learn_spread, count)
        self.equations, self.problem = equations, equations.problem
        self.records: tuple[Evidence, ...] = (self,)
        self._shown: dict[str, np.ndarray] = {}

    @cached_property
    def projection(self) -> FeatureProjection:
        """At the collocation points."""
        return self._projection(self.equations.physics)

    @cached_property
    def observer_projection(self) -> FeatureProjection:
        """At the response's samples, where it differs from :attr:`projection` if the force is held between its own."""
        return self._projection(self.equations.observation)

    def shown_noise(self, quantity: str) -> np.ndarray:
        """(channels,), noise of each sensor of a quantity that its spectrum shows above its band; 0 where none does."""
        if quantity not in self._shown:
            record = self.equations.problem.record
            shown, histories = np.zeros(len(record.sensors(quantity))), record.histories(quantity)
            for dof in np.flatnonzero(record.sensors(quantity)):
                shown[dof] = visible_floor(histories[:, dof], record.step) or 0.0
            self._shown[quantity] = shown
        return self._shown[quantity]

    def log_evidence(self, point: Point, noise: NoiseModel, factor: BorderedFactor) -> float:
        """See :meth:`DiscrepancySearch.log_evidence`."""
        own = self.record_term(point, noise, factor.readout_log_determinant)
        return own + parameter_term(self.unknown, point, noise, factor, self.prior_pull(point, noise))

    def prior_pull(self, point: Point, noise: NoiseModel) -> np.ndarray:
        """(p,), the precision of the parameters' prior times the parameters."""
        return self.equations.prior_force(point.parameters, noise).cpu().numpy()

    def record_term(self, point: Point, noise: NoiseModel, readout_log_determinant: float) -> float:
        """What the record says, without the parameters' prior and without their share of the Hessian."""
        equations = self.equations
        losses = equations.losses(point, noise)
        forces = self.force_residuals(point, noise)
        rest = sum(value for name, value in losses.items() if name not in ("physics", "observer", *OF_PARAMETERS))
        sensors = self.log_variances(noise)
        # What is probable is a force, not the motion that it makes.
        moved = self._log_density_of_motion(point, forces.count)
        return -0.5 * (forces.misfit(noise) + rest + sensors + readout_log_determinant) + moved

    def _log_density_of_motion(self, point: Point, count: int) -> float:
        """See :func:`log_density`: of the equations linearised at a motion, on the average over the record."""
        equations = self.equations
        enforced, segments = equations.target.equation.cpu().numpy() > 0, equations.physics
        pattern, tangent = equations.pattern, equations.mean_tangent(segments, point)
        stiffness, damping = (pattern.full(pattern.by_coordinate(x).cpu().numpy()) for x in tangent)
        mass = equations.dynamics.mass(equations.parameters(point)).cpu().numpy()
        kept = np.ix_(enforced, enforced)
        network, averaged = equations.network, equations.averages is not None
        degree = network.degree if averaged and isinstance(network, SplineNetwork) else None
        seen = seen_powers(count, np.pi * network.free_intervals, degree)
        return log_density(mass[enforced], damping[kept], stiffness[kept], seen)

    def log_variances(self, noise: NoiseModel) -> float:
        """Sum over all samples of the sensors; those of an observer equation stand with the forces.

        An input is compared between its samples too, where features finer than these follow it.
        """
        masks = observation_masks(self.equations.target, self.equations.problem.acceleration_through)
        samples = dict.fromkeys(masks, len(self.equations.problem.record.time))
        samples |= {name: max(samples[name], self.equations.network.count) for name in self.equations.inputs}
        of_gauges = sum(
            2.0 * rows.samples * float(np.log(sigma))
            for rows, sigma in zip(self.equations.gauge_rows, noise.response.get(GAUGE, ()), strict=True)
        )
        return of_gauges + sum(
            2.0 * samples[name] * float(np.log(noise.response[name][mask.cpu().numpy()]).sum())
            for name, mask in masks.items()
            if name != "observer"
        )

    def force_residuals(self, point: Point, noise: NoiseModel) -> ForceResiduals:
        """What the physics residual holds in the features' sight and beyond it."""
        equations = self.equations
        enforced = equations.target.equation.cpu().numpy()
        physics, weight = equations.physics_residual(point), equations.weights(noise)
        observer = None
        if "observer" in weight:
            seen_there = self.observer_projection.sum_of_squares(equations.residuals(point)["observer"])
            observer = seen_there, weight["observer"].cpu().numpy()
        left_open, unseen = np.zeros(len(enforced)), np.zeros(len(enforced))
        # A discrepancy varies within the intervals too, as far as the features follow it: that is no noise of a sensor.
        beyond = len(equations.problem.record.time) - equations.network.count if equations.refinement == 1 else 0
        if beyond > 0:
            moments = self.projection.no_moments(len(enforced))
            for part in equations.windows(equations.physics):
                forces = equations.force_residual(point, part)
                unseen += forces.square().sum((0, 1)).cpu().numpy()
                self.projection.add_moments(moments, forces, part)
            unseen -= self.projection.seen(moments)
        if equations.averages is None:
            seen, count = self.projection.sum_of_squares(physics), equations.network.count
        else:  # averages between the samples count as far as the samples tell what acts there
            trust = weight["physics"] * torch.as_tensor(noise.physics_variance).to(weight["physics"])
            seen = (physics.square() * trust).sum((0, 1)).cpu().numpy()
            count = equations.averages.count
            if trust.ndim > 1:
                left_open = -torch.where(trust > 0, trust, 1.0).log().sum((0, 1)).cpu().numpy()
        return ForceResiduals(enforced, seen, np.maximum(unseen, 0.0), count, max(beyond, 0), left_open, observer)

    def followed_force(self) -> np.ndarray:
        """(N, n), the measured force as far as the features follow it; 0 where there is none."""
        equations = self.equations
        coefficients = self.projection.coefficients(equations.target.force.cpu()).to(equations.target.force)
        segments = equations.forces
        values = (
            output_features(equations.network, segments)[0]
            @ coefficients[first_output(equations.network, segments).feature]
        )
        return segments.scatter(values)[:, : equations.dynamics.ndof].cpu().numpy()

    def _projection(self, segments: Segments) -> FeatureProjection:
        network = self.equations.network
        return FeatureProjection(first_output(network, segments), output_features(network, segments)[0])

    @property
    def unknown(self) -> np.ndarray:
        """See :attr:`DiscrepancySearch.unknown`."""
        return self.equations.unknown.cpu().numpy()

    def occupied(self, trained: Trained) -> list[float]:
        """See :meth:`DiscrepancySearch.occupied`."""
        return self.each_record(occupied_share, trained)

    def each_record(self, function: Callable[..., R], trained: Trained, *arguments: Sequence[Any]) -> list[R]:
        """See :meth:`DiscrepancySearch.each_record`: there is one."""
        return [function(self, trained, *(of_record[0] for of_record in arguments))]


def occupied_share(evidence: Evidence, trained: Trained) -> float:
    """N_eff / K, see :meth:`DiscrepancySearch.widen_for_colour`."""
    equations = evidence.equations
    unforced = equations.target.unforced & equations.dynamics.has_mass.to(equations.target.unforced.device)
    enforced = unforced if bool(unforced.any()) else equations.target.equation
    residual, step = equations.physics_residual(trained.solution.point), 1.0 / equations.network.free_intervals
    if equations.averages is None:
        residual, step = equations.physics.scatter(residual), equations.problem.record.step
    else:
        residual = equations.averages.by_interval(residual)
    return occupied_band(residual[:, enforced].cpu().numpy(), step, equations.network.free_intervals / 2.0)


def parameter_term(
    unknown: np.ndarray, point: Point, noise: NoiseModel, factor: BorderedFactor, pull: np.ndarray
) -> float:
    """The parameters' part of the log evidence: their prior, and their Hessian with the readout eliminated.

    Args:
        unknown: (p,) bool; the others share one spread.
        point: Of the solution.
        noise: That it was found under.
        factor: Of the Hessian there.
        pull: (p,), the prior's precision times the parameters.
    """
    believed = int((~unknown).sum())
    loss = float(np.sum(pull * point.parameters.cpu().numpy()))
    return -0.5 * (loss + factor.parameter_log_determinant + 2.0 * believed * np.log(noise.spread))
