"""How probable the record is under a noise model, and the search for the model error that makes it most probable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from pinn_cli.network.linear_readout import Segments
from pinn_cli.physics import observation_masks
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.band.bordered import BorderedFactor
from pinn_cli.training.band.force_residuals import ForceResiduals
from pinn_cli.training.band.levenberg_marquardt import Solution, minimise
from pinn_cli.training.band.normal_equations import NormalEquations, Point
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel, first_output, output_features
from pinn_cli.training.parameter_spread import updated_spread

# A mass at its bound of zero has a logarithm too, kg.
LEAST_MASS = 1e-300
# The scan over the discrepancy goes down by this factor: half a decade, fine enough for a parabola through three
# points.
SCAN_FACTOR = 10.0**0.5
# A drop of the log evidence by this much ends the scan: the odds against anything stiffer are e^-20.
DECISIVE_DROP = 20.0
# The scan also ends after this many steps without a gain, or at this fraction of the force that it began with.
PATIENCE, FINEST_DISCREPANCY = 3, 1e-8
# A model error above this part of the force is either a model that is far off or a search that went astray: it is worth
# a second search from another start.
SUSPICIOUS_DISCREPANCY = 0.01
# Parabolas at most, and the gain in log evidence below which another is not worth a solution.
REFINEMENTS, NEGLIGIBLE_GAIN = 4, 0.5
# Relative change of the spread below which it is settled (a few parameters tell it to some tens of percent), and rounds
# at most.
SPREAD_TOLERANCE, SPREAD_ROUNDS = 0.05, 4


@dataclass(frozen=True, eq=False)
class Trained:
    """A solution together with the noise model that it was found under.

    Attributes:
        solution: The most probable readout and parameters.
        noise: Its weights.
        factor: Undamped factors of the Hessian there.
        log_evidence: Logarithm of the probability density of the record, up to a constant of the network and record.
    """

    solution: Solution
    noise: NoiseModel
    factor: BorderedFactor
    log_evidence: float


class Evidence:
    """Laplace approximation of the marginal likelihood of a noise model (MacKay 1992), everything integrated out.

    Readout and parameters are integrated out. The physics residual counts as what the features can see of it, K values
    per DOF with a discrepancy that is white among them; beyond that there is nothing but the force sensors' noise.
    """

    def __init__(
        self,
        equations: NormalEquations,
        iterations: int,
        tolerance: float,
        watch: Callable[[dict[str, float], NoiseModel], None],
        learn_spread: bool = True,
    ) -> None:
        self.learn_spread = learn_spread
        self.equations, self.iterations, self.tolerance, self.watch = equations, iterations, tolerance, watch

    @cached_property
    def projection(self) -> FeatureProjection:
        """At the collocation points."""
        return self._projection(self.equations.physics)

    @cached_property
    def observer_projection(self) -> FeatureProjection:
        """At the response's samples, where it differs from :attr:`projection` if the force is held between its own."""
        return self._projection(self.equations.observation)

    def train(self, noise: NoiseModel, start: Point) -> Trained | None:
        """Solve under a noise model; None where the Hessian is too stiff for a Cholesky factor."""
        equations = self.equations
        watch = lambda losses: self.watch(losses, noise)  # noqa: E731
        solution = minimise(equations, noise, start, self.iterations, self.tolerance, watch)
        factor = solution.factor or equations.assemble(solution.point, noise).factor()
        if factor is None:
            return None
        return Trained(solution, noise, factor, self.log_evidence(solution.point, noise, factor))

    def log_evidence(self, point: Point, noise: NoiseModel, factor: BorderedFactor) -> float:
        """-1/2 [chi^2 + sum of log variances + log det Hessian - log det prior] at the most probable point."""
        equations = self.equations
        losses = equations.losses(point, noise)
        forces = self.force_residuals(point, noise)
        rest = sum(value for name, value in losses.items() if name not in ("physics", "observer"))
        prior = -2.0 * int((~equations.unknown).sum()) * np.log(noise.spread)
        # What physics says of a motion is a density of accelerations, not of forces: else a massless chain, on which
        # every motion balances, would be the most probable of all.
        moving = equations.target.equation[: equations.dynamics.ndof]
        mass = equations.parameters(point)["m"][moving].cpu().numpy()
        inertia = 2.0 * forces.count * float(np.log(np.maximum(mass, LEAST_MASS)).sum())
        sensors = self._log_variances(noise)
        driven = self._innovation_density(forces.count)
        return -0.5 * (forces.misfit(noise) + rest + sensors + factor.log_determinant - prior - inertia) + driven

    def _innovation_density(self, count: int) -> float:
        """Logarithm of the determinant from unknown forces to what drives them, w' + w / tau over the rate.

        What is probable is a force, not what drives it. Over the frequencies that the features follow it is the sum of
        log |i omega + 1 / tau|.
        """
        inputs = self.equations.problem.inputs
        if not inputs.forces:
            return 0.0
        omega = np.pi * self.equations.network.free_intervals * (np.arange(count) + 0.5) / count
        gain = np.hypot(omega, 1.0 / inputs.correlation_time) / inputs.rate
        return len(inputs.forces) * float(np.log(gain).sum())

    def _log_variances(self, noise: NoiseModel) -> float:
        """Of the response sensors; those of an observer equation stand with the forces."""
        masks = observation_masks(self.equations.target, self.equations.problem.acceleration_through)
        samples = len(self.equations.problem.record.time)
        return sum(
            2.0 * samples * float(np.log(noise.response[name][mask.cpu().numpy()]).sum())
            for name, mask in masks.items()
            if name != "observer"
        )

    def force_residuals(self, point: Point, noise: NoiseModel) -> ForceResiduals:
        """What the physics residual holds in the features' sight and beyond it."""
        equations = self.equations
        enforced = equations.target.equation.cpu().numpy()
        residuals, weight = equations.residuals(point), equations.weights(noise)
        observer = None
        if "observer" in residuals:
            seen_there = self.observer_projection.sum_of_squares(residuals["observer"])
            observer = seen_there, weight["observer"].cpu().numpy()
        left_open, unseen = np.zeros(len(enforced)), np.zeros(len(enforced))
        # A discrepancy varies within the intervals too, as far as the features follow it: that is no noise of a sensor.
        beyond = len(equations.problem.record.time) - equations.network.count if equations.refinement == 1 else 0
        if beyond > 0:
            forces = equations.force_residual(point)
            unseen = forces.square().sum((0, 1)).cpu().numpy() - self.projection.sum_of_squares(forces)
        if equations.averages is None:
            seen, count = self.projection.sum_of_squares(residuals["physics"]), equations.network.count
        else:  # averages between the samples count as far as the samples tell what acts there
            trust = weight["physics"] * torch.as_tensor(noise.physics_variance).to(weight["physics"])
            seen = (residuals["physics"].square() * trust).sum((0, 1)).cpu().numpy()
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

    def search(
        self, noise: NoiseModel, force: float, second_start: Callable[[], Point | None], refined: bool = True
    ) -> Trained:
        """Most probable discrepancy and spread, from rest and, where that finds no good model, from another start.

        Where a structure is strongly nonlinear, the motion that soft physics finds may lie in the wrong valley.

        Args:
            noise: Sensor noise; its discrepancy is ignored.
            force: That acts, N.
            second_start: Another motion to begin with; None: there is none.
            refined: Whether to close in on the peak; not where all levels settle together afterwards.

        Raises:
            DivergenceError: Even the softest physics cannot be solved.
        """
        found = self.scan(noise, force, self.equations.start(), refined)
        if found.solution.converged and found.noise.discrepancy < SUSPICIOUS_DISCREPANCY * force:
            return found
        start = second_start()
        if start is None:
            return found
        try:
            other = self.scan(noise, SUSPICIOUS_DISCREPANCY * force, start, refined)
        except DivergenceError:
            return found
        return max(found, other, key=lambda trained: trained.log_evidence)

    def scan(self, noise: NoiseModel, largest: float, start: Point, refined: bool = True) -> Trained:
        """Most probable discrepancy and spread of the parameters, searched from soft physics to stiff.

        Every solution starts at the last. Soft physics is nearly linear and forgives a start at rest; each stiffer
        problem begins next to its solution. So the search for the noise level is also the continuation that long and
        stiff records need.

        Args:
            noise: Sensor noise; its discrepancy is ignored.
            largest: Where to begin, N: with a start at rest the force that acts.
            start: The motion to begin with.
            refined: See :meth:`search`.

        Raises:
            DivergenceError: The first problem cannot be solved.
        """
        tried: list[Trained] = []
        point, discrepancy, idle = start, largest, 0
        best: Trained | None = None
        while discrepancy > FINEST_DISCREPANCY * largest and idle < PATIENCE:
            trained = self.train(noise.with_discrepancy(discrepancy), point)
            followed = best is not None and best.solution.converged
            if trained is None or (followed and not trained.solution.converged):
                break  # stiffer than these steps or these numbers can follow
            tried.append(trained)
            point, noise = trained.solution.point, noise.with_spread(self.learned_spread(trained))
            idle = 0 if best is None or trained.log_evidence > best.log_evidence else idle + 1
            best = trained if best is None or idle == 0 else best
            if trained.log_evidence < best.log_evidence - DECISIVE_DROP:
                break
            discrepancy /= SCAN_FACTOR
        if best is None:
            raise DivergenceError(
                "the softest physics already has a singular normal matrix; use fewer knots or more sensors"
            )
        return self._settle_spread(self._refine(tried, best)) if refined else best

    def _refine(self, tried: list[Trained], best: Trained) -> Trained:
        """Close in on the most probable discrepancy by parabolas through the best and its neighbours."""
        for _ in range(REFINEMENTS):
            tried.sort(key=lambda trained: trained.noise.discrepancy)
            middle = tried.index(best)
            if not 0 < middle < len(tried) - 1:
                break
            top = _parabola_top(tried[middle - 1 : middle + 2])
            if top is None or top[1] - best.log_evidence < NEGLIGIBLE_GAIN:
                break
            trained = self.train(best.noise.with_discrepancy(top[0]), best.solution.point)
            if trained is None or not trained.solution.converged:
                break
            tried.append(trained)
            best = max(best, trained, key=lambda candidate: candidate.log_evidence)
        return best

    def widen_for_colour(self, trained: Trained) -> Trained:
        """Solve once more with the discrepancy that its own colour asks for.

        The search takes the discrepancy for K independent values per DOF. A model error that fills only part of the
        features' band has fewer, N_eff, and larger ones; counting K of them makes states look better known than they
        are. N_eff / K is the bandwidth of the physics residual, (sum S)^2 / (M sum S^2), over the M frequencies that
        the features follow.
        """
        equations = self.equations
        unforced = equations.target.unforced & equations.dynamics.has_mass.to(equations.target.unforced.device)
        enforced = unforced if bool(unforced.any()) else equations.target.equation
        residual, step = equations.residuals(trained.solution.point)["physics"], 1.0 / equations.network.free_intervals
        if equations.averages is None:
            residual, step = equations.physics.scatter(residual), equations.problem.record.step
        else:
            residual = equations.averages.by_interval(residual)
        share = occupied_band(residual[:, enforced].cpu().numpy(), step, equations.network.free_intervals / 2.0)
        wider = self.train(trained.noise.widened(share), trained.solution.point)
        return wider if wider is not None and wider.solution.converged else trained

    def learned_spread(self, trained: Trained) -> float:
        """How far the prescribed parameters are off, in common; see :func:`updated_spread`."""
        believed = ~self.equations.unknown
        x = trained.solution.point.parameters[believed]
        if not self.learn_spread or len(x) == 0:
            return trained.noise.spread
        variance = np.diag(trained.factor.corner_covariance)[believed.cpu().numpy()]
        return updated_spread(x.cpu().numpy(), variance, trained.noise.spread)

    def _settle_spread(self, trained: Trained) -> Trained:
        """Alternate spread and solution under one discrepancy until the spread stays."""
        for _ in range(SPREAD_ROUNDS):
            spread = self.learned_spread(trained)
            if abs(spread / trained.noise.spread - 1.0) < SPREAD_TOLERANCE:
                break
            again = self.train(trained.noise.with_spread(spread), trained.solution.point)
            if again is None or not again.solution.converged:
                break
            trained = again
        return trained


def _parabola_top(three: list[Trained]) -> tuple[float, float] | None:
    """Discrepancy and log evidence at the top of the parabola through three of them; None where it opens upwards."""
    x = np.log([trained.noise.discrepancy for trained in three])
    curvature, slope, level = np.polyfit(x - x[1], [trained.log_evidence for trained in three], 2)
    if curvature >= 0:
        return None
    # A lopsided peak throws the parabola onto a neighbour: stay inside.
    offset = np.clip(-0.5 * slope / curvature, 0.9 * (x[0] - x[1]), 0.9 * (x[2] - x[1]))
    return float(np.exp(x[1] + offset)), float(level + offset * (slope + curvature * offset))
