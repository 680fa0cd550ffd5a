"""A solution of a problem, how one is looked for, and where its noise levels start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.model.knowledge import DiscrepancyEvidence
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.network import NetworkDesign
from pinn_cli.record.channels import support_amplitudes
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import FORCE, GROUND, MOTION, SUPPORT
from pinn_cli.training.estimate import Rival
from pinn_cli.training.estimator import built
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.history import History
from pinn_cli.training.levels import ROUNDS, settled
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_scales import CONTINUITY_TOLERANCE, force_and_velocity_scale, newtons
from pinn_cli.training.sensor_samples import starting_levels
from pinn_cli.training.whittle.whittle_estimate import KnownParameters

# Steps at most under one noise model, and the relative decrease of the loss below which one has converged.
ITERATIONS, TOLERANCE = 15, 1e-6


@dataclass(frozen=True, eq=False)
class Solver:
    """How a problem is solved.

    Attributes:
        designs: Of the networks of the records, one each.
        history: Of all steps.
        iterations, tolerance: Steps at most under one noise model, and the relative decrease of the loss that ends
            them.
        learn_spread: Whether the common spread of the prescribed parameters is learned from the record.
        pooled: Whether the sensors of one quantity share one noise level.
        known_parameters: Parameters that spectra determine, and that are held.
    """

    designs: tuple[NetworkDesign, ...]
    history: History
    iterations: int = ITERATIONS
    tolerance: float = TOLERANCE
    learn_spread: bool = True
    pooled: bool = False
    known_parameters: KnownParameters | None = None

    def networks(self, problem: JointProblem) -> list[LinearReadout]:
        """One for every record."""
        networks = [built(design, record_problem) for design, record_problem in zip(self.designs, problem, strict=True)]
        assert all(isinstance(network, LinearReadout) for network in networks)
        return networks  # type: ignore[return-value]

    def evidence(self, problem: JointProblem, networks: Sequence[LinearReadout] | None = None) -> Evidence:
        """What finds the solutions of a problem; with these networks, else with those of the designs."""
        pairs = zip(problem, networks or self.networks(problem), strict=True)
        equations = [
            NormalEquations(network, record_problem, self.known_parameters) for record_problem, network in pairs
        ]
        history = self.history
        return Evidence(equations, self.iterations, self.tolerance, history.add_step, self.learn_spread, history.count)

    def starting_noise(self, evidence: Evidence) -> NoiseLevels:
        """Where the levels of all records start; the discrepancy is the force that acts."""
        noise = NoiseLevels(tuple(map(starting_noise, evidence.equations.by_record)))
        noise = noise.each(NoiseModel.pooled) if self.pooled else noise
        return noise if self.known_parameters is None else replace(noise, spread=self.known_parameters.spread)

    def settled(self, evidence: Evidence, trained: Trained, rounds: int = ROUNDS) -> Trained:
        """The same solution under its own noise levels."""
        return settled(evidence, trained, self.pooled, rounds)


@dataclass(frozen=True, eq=False)
class FreeRunning:
    """A solution without any discrepancy, and how well its parameters are known, in prior standard deviations.

    Attributes:
        trained: The solution.
        covariance: (p, p), over records that were made in the same way.
        varying: (p,), standard deviation over the conditions of this record.
    """

    trained: Trained
    covariance: np.ndarray
    varying: np.ndarray


@dataclass(frozen=True, eq=False)
class Inference:
    """A solution, and what is known beside it.

    Attributes:
        evidence: That it was found with.
        trained: The solution.
        solver: How it was looked for.
        rivals: Others that explain the record as well.
        discrepancy: What the windows of a record say of it so far.
        narrowed: How many times as large the deviation of an unknown parameter was before the features were last made
            finer; of all the most.
        at_marginal_peak: Whether the parameters are the most probable ones with the motion integrated out.
        ends: Of the forces that nobody measured, of every record, Hz: on the way to that peak they come down only.
        free: Where the model does not quite hold, solutions whose structure runs free.
        smooth: There, too, the solution in which the force that it leaves out is smooth; None: it was not found.
        log_odds_of_place: Of such a solution with one force alone, the logarithm of how many times as probable the
            record is as with one on every coordinate; 0 with these.
    """

    evidence: Evidence
    trained: Trained
    solver: Solver
    rivals: tuple[Rival, ...] = ()
    discrepancy: DiscrepancyEvidence | None = None
    narrowed: float = 1.0
    at_marginal_peak: bool = False
    ends: tuple[float, ...] = ()
    free: Sequence[FreeRunning] = ()
    smooth: Inference | None = None
    log_odds_of_place: float = 0.0

    @property
    def problem(self) -> JointProblem:
        """Of all records."""
        return self.evidence.problem

    @property
    def by_record(self) -> list[tuple[NormalEquations, Point]]:
        """Of every record its equations, and the point where they are solved."""
        equations = self.evidence.equations
        return list(zip(equations.by_record, equations.split(self.trained.solution.point), strict=True))

    @property
    def is_informed(self) -> bool:
        """Whether the parameters or the levels are known from elsewhere: from spectra, or from earlier records."""
        return self.solver.known_parameters is not None or self.problem.is_informed

    @property
    def explains_something(self) -> bool:
        """Whether the force that the model leaves out is below the one that acts."""
        noise = self.trained.noise.records[0]
        acting = self.solver.starting_noise(self.evidence).discrepancy
        return bool(noise.discrepancy * noise.occupied**0.5 < acting)


def starting_noise(equations: NormalEquations) -> NoiseModel:
    """Where the noise levels of one record start; the discrepancy is the force that acts."""
    problem = equations.problem
    force, velocity = force_and_velocity_scale(problem)
    quantities = [*problem.record.response_quantities, *((FORCE,) if problem.dynamics.inputs.loads else ())]
    response = {quantity: np.full(len(problem.record.sensors(quantity)), np.nan) for quantity in quantities}
    response |= {channels.name: channels.numbers("first") for channels in equations.channels}
    if equations.observer is not None:
        response["acceleration"] = starting_levels(problem.record, "acceleration")
    points, dynamics = equations.refinement, problem.dynamics
    innovation, sensors = np.full((2, dynamics.size), np.nan)
    if equations.target.measured_force.any():  # otherwise load cells are channels
        sensors[: dynamics.ndof] = starting_levels(problem.record, FORCE)
    # A force of modes acts on a DOF the more, the less this DOF moves with them.
    innovation[dynamics.forces] = force / newtons(problem)
    innovation[dynamics.loads] = [np.std(problem.record.force[:, dof]) for dof in dynamics.inputs.loads]
    if problem.record.measured_ground is not None:
        innovation[dynamics.ground] = np.std(problem.record.measured_ground)
    if dynamics.structure.supports:
        innovation[dynamics.supports] = support_amplitudes(problem.record)
    continuity = CONTINUITY_TOLERANCE * velocity
    return NoiseModel(
        response,
        sensors,
        force,
        continuity,
        points_per_sample=points,
        innovation=None if dynamics.is_plain else innovation,
        pushes=_pushes(equations),
    )


def _pushes(equations: NormalEquations) -> dict[str, np.ndarray]:
    """See :class:`NoiseModel`; a support's displacement pushes by a spring, its acceleration by a mass."""
    structure, record = equations.problem.structure, equations.problem.record
    masses = structure.parameters[MASS].detach().cpu().numpy()
    by_quantity = {FORCE: structure.shapes.scale}
    if record.measured_ground is not None:
        by_quantity[GROUND] = _least(masses * structure.with_ground)
    if structure.by_supports is not None:
        moved = abs(structure.by_supports).sum(axis=1).A1 > 0.0
        stiffness, mass = _least(structure.at_rest()[0].sum(axis=0)[: len(moved)][moved]), _least(masses)
        for quantity in record.supports:
            order = MOTION.index(SUPPORT[quantity])
            by_quantity[quantity] = stiffness ** (1.0 - order / 2.0) * mass ** (order / 2.0)
    return {
        channels.name: np.array(
            [by_quantity.get(sensor.channel.quantity, np.nan) if sensor else np.nan for sensor in channels.sensors]
        )
        for channels in equations.channels
    }


def _least(values: np.ndarray) -> float:
    """Size of the least that is not zero."""
    return float(np.min(np.abs(values[values != 0.0]), initial=math.inf))
