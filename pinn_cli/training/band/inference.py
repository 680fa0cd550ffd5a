"""From a problem to its most probable solution: discrepancy searched, noise levels settled, features fine enough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pinn_cli.network.base import NetworkDesign
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.band.discrepancy_search import NEGLIGIBLE_GAIN, Trained
from pinn_cli.training.band.evidence import Evidence
from pinn_cli.training.band.noise_levels import settled
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.resolution import carried_over, knots_wanted
from pinn_cli.training.band.simulated_start import simulated_start
from pinn_cli.training.base import built
from pinn_cli.training.history import History
from pinn_cli.training.noise_model import NoiseModel, starting_levels
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

    evidence: Evidence
    trained: Trained


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


def inferred(
    problem: Problem, design: NetworkDesign, settings: InferenceSettings, device: str, history: History
) -> Inferred:
    """The most probable readout and parameters under the most probable noise levels.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    found = _best_start(problem, design, settings, device, history)
    found = _with_correlation(found, settings, device, history)
    for _ in range(REFINEMENTS):
        factor = knots_wanted(found.evidence, found.trained)
        finer = design.finer(factor)
        if finer is None or factor < WORTHWHILE:
            break
        again = _refined(found, finer, settings, device, history)
        if again is None:
            break
        design, found = finer, again
    return Inferred(found.evidence, found.evidence.widen_for_colour(found.trained))


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
        evidence = settings.solved_by(start, _built(design, start), device, history)
        noise = starting_noise(evidence)
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


def _searched(evidence: Evidence, noise: NoiseModel) -> Trained:
    """The most probable discrepancy, under noisier sensors too where the model explains nothing under these.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    second = partial(simulated_start, evidence.equations)
    best = evidence.search(noise, noise.discrepancy, second, refined=False)
    for factor in NOISIER:
        if best.solution.converged and best.noise.discrepancy < NOTHING_EXPLAINED * noise.discrepancy:
            break
        response = {quantity: factor * level for quantity, level in noise.response.items()}
        try:
            again = evidence.search(replace(noise, response=response), noise.discrepancy, second, refined=False)
        except DivergenceError:
            break
        best = max(best, again, key=lambda trained: (trained.solution.converged, trained.log_evidence))
    return best


def starting_noise(evidence: Evidence) -> NoiseModel:
    """Where the noise levels of a problem start; the discrepancy is the force that acts."""
    problem = evidence.equations.problem
    force, velocity = force_and_velocity_scale(problem)
    response, sensors = starting_levels(problem.record)
    points, dynamics, shapes = evidence.equations.refinement, problem.dynamics, problem.structure.shapes
    driving = np.full(dynamics.size, np.nan)
    if shapes is not None:
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
    if not found.evidence.equations.problem.inputs.forces:
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
    equations, trained = found.evidence.equations, found.trained
    inputs = equations.problem.inputs
    other = replace(inputs, correlation_time=factor * inputs.correlation_time)
    problem = replace(equations.problem, inputs=other, alternatives=())
    evidence = settings.solved_by(problem, equations.network, device, history)
    driving = trained.noise.innovation
    assert driving is not None
    again = evidence.train(replace(trained.noise, innovation=driving / factor**0.5), trained.solution.point)
    if again is None or not again.solution.converged:
        return None
    return Inferred(evidence, settled(evidence, again, settings.pooled, CORRELATION_ROUNDS))


def _refined(
    found: Inferred, design: NetworkDesign, settings: InferenceSettings, device: str, history: History
) -> Inferred | None:
    """The same solution in finer features; None where they cannot be solved."""
    coarse, trained = found.evidence.equations, found.trained
    evidence = settings.solved_by(coarse.problem, _built(design, coarse.problem), device, history)
    fine = evidence.equations
    more = (fine.refinement / coarse.refinement) ** 0.5
    discrepancy, points = more * trained.noise.discrepancy, fine.refinement
    noise = replace(trained.noise, discrepancy=discrepancy, points_per_sample=points)
    again = evidence.train(noise, carried_over(trained, coarse, fine))
    if again is None or not again.solution.converged:
        return None
    return Inferred(evidence, settled(evidence, again, settings.pooled))


def _built(design: NetworkDesign, problem: Problem) -> LinearReadout:
    network = built(design, problem)
    assert isinstance(network, LinearReadout)
    return network
