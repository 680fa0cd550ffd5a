"""From a problem to its most probable solution: discrepancy searched, noise levels settled, features fine enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pinn_cli.network.base import NetworkDesign
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.spline import Spline
from pinn_cli.record.gauge import GAUGE
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.band.discrepancy_search import NEGLIGIBLE_GAIN, Trained
from pinn_cli.training.band.evidence import Evidence
from pinn_cli.training.band.joint.evidence import JointEvidence
from pinn_cli.training.band.noise_levels import settled
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.resolution import carried_over, knots_wanted
from pinn_cli.training.band.simulated_start import simulated_start
from pinn_cli.training.base import built
from pinn_cli.training.history import History
from pinn_cli.training.noise_model import NoiseModel, first_level, starting_levels
from pinn_cli.training.record_scales import CONTINUITY_TOLERANCE, force_and_velocity_scale

# Steps at most under one noise model, and the relative decrease of the loss below which one has converged.
ITERATIONS, TOLERANCE = 12, 1e-6
# A discrepancy of this part of the force that acts explains nothing; then the sensors are taken to be so many times as
# noisy as their spectra say.
NOTHING_EXPLAINED, NOISIER = 0.3, (3.0, 10.0)
# Steps of the correlation time of unknown forces, and how many are taken at most in one direction.
CORRELATION_FACTOR, CORRELATION_STEPS = 3.0, 6
# Rounds of the noise levels under each.
CORRELATION_ROUNDS = 3
# Times that the features are made finer at most, and the factor on their number below which that is not worth it.
REFINEMENTS, WORTHWHILE = 2, 1.1


@dataclass(frozen=True, eq=False)
class Inferred:
    """A solution and what it was found with."""

    evidence: Evidence | JointEvidence
    trained: Trained

    @property
    def by_record(self) -> list[tuple[NormalEquations, Point]]:
        """Of every record its equations, and the point where they are solved."""
        equations = self.evidence.equations
        points = equations.split(self.trained.solution.point)
        return list(zip([own.equations for own in self.evidence.records], points, strict=True))


@dataclass(frozen=True)
class InferenceSettings:
    """How a problem is solved; see :class:`pinn_cli.training.gauss_newton.GaussNewton`."""

    iterations: int
    tolerance: float
    learn_spread: bool
    pooled: bool

    def solved_by(self, problem: Problem, network: LinearReadout, device: str, history: History) -> Evidence:
        """What finds the solutions of one network."""
        equations = NormalEquations(network, problem, device)
        return Evidence(equations, self.iterations, self.tolerance, history.add_step, self.learn_spread)

    def all_solved_by(
        self, problem: Problem, networks: Sequence[LinearReadout], device: str, history: History
    ) -> Evidence | JointEvidence:
        """What finds the solutions of one network for every record."""
        pairs = zip(problem.by_record, networks, strict=True)
        records = [self.solved_by(own, network, device, history) for own, network in pairs]
        return records[0] if len(records) == 1 else JointEvidence(problem, records)


def inferred(
    problem: Problem, design: NetworkDesign, settings: InferenceSettings, device: str, history: History
) -> Inferred:
    """The most probable readout and parameters under the most probable noise levels.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    designs = [design] * len(problem.by_record)
    found = _best_start(problem, design, settings, device, history)
    found = _with_correlation(found, settings, device, history)
    for _ in range(REFINEMENTS):
        finer = _finer(designs, found)
        again = None if finer is None else _refined(found, finer, settings, device, history)
        if finer is None or again is None:
            break
        designs, found = finer, again
    return Inferred(found.evidence, found.evidence.widen_for_colour(found.trained))


def _finer(designs: Sequence[NetworkDesign], found: Inferred) -> list[NetworkDesign] | None:
    """Designs with finer features for the records that want them; None where none does, or none can have them."""
    wanted = found.evidence.each_record(knots_wanted, found.trained)
    finer = [
        design.finer(factor) if factor >= WORTHWHILE else None for design, factor in zip(designs, wanted, strict=True)
    ]
    if not any(finer):
        return None
    return [new or old for new, old in zip(finer, designs, strict=True)]


def inferred_sensor_noise(problem: Problem, device: str = "cpu") -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Noise of every response sensor and of every force sensor, each (n,), for estimators that infer none themselves.

    That of a spline's solution of the same problem; where there is none, what the spectra show.
    """
    settings, history = InferenceSettings(ITERATIONS, TOLERANCE, learn_spread=True, pooled=False), History(False)
    try:
        found = _best_start(replace(problem, alternatives=()), Spline(), settings, device, history)
    except DivergenceError:
        return starting_levels(problem.record)
    noise = found.trained.noise
    return noise.response, noise.response.get(FORCE, noise.force[: problem.dynamics.ndof])


def _best_start(
    problem: Problem, design: NetworkDesign, settings: InferenceSettings, device: str, history: History
) -> Inferred:
    """The most probable of the solutions from every start of the unknown parameters.

    Raises:
        DivergenceError: None could be solved.
    """
    solutions: list[Inferred] = []
    failure: DivergenceError | None = None
    for start in (problem, *problem.alternatives):
        networks = [_built(design, own) for own in start.by_record]
        evidence = settings.all_solved_by(start, networks, device, history)
        noise = NoiseModel.of_records([starting_noise(own) for own in evidence.records])
        noise = noise.pooled() if settings.pooled else noise
        try:
            trained = _searched(evidence, noise)
        except DivergenceError as error:
            failure = error
            continue
        solutions.append(Inferred(evidence, settled(evidence, trained, settings.pooled)))
    if not solutions:
        raise failure or DivergenceError("there is no start")
    return max(solutions, key=lambda found: found.trained.log_evidence)


def _searched(evidence: Evidence | JointEvidence, noise: NoiseModel) -> Trained:
    """The most probable discrepancy, under noisier sensors too where the model explains nothing under these.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    second = partial(_simulated_start, evidence)
    best = evidence.search(noise, noise.discrepancy, second, refined=False)
    for factor in NOISIER:
        if best.solution.converged and best.noise.discrepancy < NOTHING_EXPLAINED * noise.discrepancy:
            break
        try:
            again = evidence.search(noise.noisier(factor), noise.discrepancy, second, refined=False)
        except DivergenceError:
            break
        best = max(best, again, key=lambda trained: (trained.solution.converged, trained.log_evidence))
    return best


def _simulated_start(evidence: Evidence | JointEvidence) -> Point | None:
    """See :func:`simulated_start`; None where there is none of any record."""
    points = [simulated_start(own.equations) for own in evidence.records]
    return evidence.equations.joined(points) if all(points) else None  # type: ignore[arg-type]


def starting_noise(evidence: Evidence) -> NoiseModel:
    """Where the noise levels of a problem start; the discrepancy is the force that acts."""
    problem = evidence.equations.problem
    force, velocity = force_and_velocity_scale(problem)
    response, sensors = starting_levels(problem.record)
    points, dynamics, shapes = evidence.equations.refinement, problem.dynamics, problem.structure.shapes
    driving = np.full(dynamics.size, np.nan)
    for quantity, levels in (*response.items(), (FORCE, sensors)):
        levels[problem.record.gauged(quantity)] = np.nan
    if problem.record.gauges:
        response[GAUGE] = np.array([first_level(gauge) for gauge in problem.record.gauges])
    if shapes is not None or dynamics.inputs.loads:
        response |= {FORCE: sensors} if dynamics.inputs.loads else {}
        sensors = np.full(dynamics.ndof, np.nan)
    sensors = np.pad(sensors, (0, dynamics.size - dynamics.ndof), constant_values=np.nan)
    # A force of modes acts on a DOF the more, the less this DOF moves with them.
    driving[dynamics.forces] = force if shapes is None else force / shapes.scale
    driving[dynamics.loads] = [np.std(problem.record.force[:, dof]) for dof in dynamics.inputs.loads]
    if problem.record.ground_acceleration is not None:
        driving[dynamics.ground] = np.std(problem.record.ground_acceleration)
    continuity = CONTINUITY_TOLERANCE * velocity
    return NoiseModel(
        response,
        sensors,
        force,
        continuity,
        points_per_sample=points,
        innovation=None if dynamics.is_plain else driving,
    )


def _with_correlation(found: Inferred, settings: InferenceSettings, device: str, history: History) -> Inferred:
    """The solution under the most probable correlation time of the unknown forces, if there are any."""
    if not any(own.inputs.forces for own in found.evidence.problem.by_record):
        return found
    for factor in (CORRELATION_FACTOR, 1.0 / CORRELATION_FACTOR):
        improved = False
        for _ in range(CORRELATION_STEPS):
            again = _correlated(found, factor, settings, device, history)
            if again is None or again.trained.log_evidence < found.trained.log_evidence + NEGLIGIBLE_GAIN:
                break
            found, improved = again, True
        if improved:
            break
    return found


def _correlated(
    found: Inferred, factor: float, settings: InferenceSettings, device: str, history: History
) -> Inferred | None:
    """The solution with another correlation time; what drives the forces keeps their size."""
    slower = replace(found.evidence.problem, alternatives=())
    first, *others = [_with_correlation_time(own, factor) for own in slower.by_record]
    networks = [own.equations.network for own in found.evidence.records]
    evidence = settings.all_solved_by(replace(first, further=tuple(others)), networks, device, history)
    levels = zip(slower.by_record, found.trained.noise.by_record, strict=True)
    driving = [_driven_for(level, factor) if own.inputs.forces else level for own, level in levels]
    again = evidence.train(NoiseModel.of_records(driving), found.trained.solution.point)
    if again is None or not again.solution.converged:
        return None
    return Inferred(evidence, settled(evidence, again, settings.pooled, CORRELATION_ROUNDS))


def _with_correlation_time(problem: Problem, factor: float) -> Problem:
    inputs = problem.inputs
    return replace(problem, inputs=replace(inputs, correlation_time=factor * inputs.correlation_time))


def _driven_for(noise: NoiseModel, factor: float) -> NoiseModel:
    """What drives unknown forces whose correlation time is so many times as long; it keeps their size."""
    return noise if noise.innovation is None else replace(noise, innovation=noise.innovation / factor**0.5)


def _refined(
    found: Inferred, designs: Sequence[NetworkDesign], settings: InferenceSettings, device: str, history: History
) -> Inferred | None:
    """The same solution in finer features; None where they cannot be solved."""
    problem = replace(found.evidence.problem, alternatives=())
    networks = [_built(design, own) for design, own in zip(designs, problem.by_record, strict=True)]
    evidence = settings.all_solved_by(problem, networks, device, history)
    levels, points = [], []
    for (coarse, point), noise, own in zip(
        found.by_record, found.trained.noise.by_record, evidence.records, strict=True
    ):
        fine = own.equations
        more = (fine.refinement / coarse.refinement) ** 0.5
        discrepancy, per_sample = more * noise.discrepancy, fine.refinement
        levels.append(replace(noise, discrepancy=discrepancy, points_per_sample=per_sample))
        points.append(carried_over(point, coarse, fine))
    again = evidence.train(NoiseModel.of_records(levels), evidence.equations.joined(points))
    if again is None or not again.solution.converged:
        return None
    return Inferred(evidence, settled(evidence, again, settings.pooled))


def _built(design: NetworkDesign, problem: Problem) -> LinearReadout:
    network = built(design, problem)
    assert isinstance(network, LinearReadout)
    return network
