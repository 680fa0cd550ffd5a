"""How probable all records that are solved together are under noise models of theirs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.training.least_squares import LeastSquares
from pinn_cli.training.minimise import Point, Solution, minimise
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel, updated_spread
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.bordered import BorderedFactor, Eliminated, SharedFactor
from pinn_cli.training.record_evidence import OF_PARAMETERS, RecordEvidence, RecordSolution

R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class Trained:
    """A solution together with the noise levels that it was found under.

    Attributes:
        solution: The most probable readout and parameters.
        noise: Its weights.
        factor: Undamped factors of the Hessian there.
        log_evidence: Logarithm of the probability density of the records, up to a constant of networks and records.
    """

    solution: Solution
    noise: NoiseLevels
    factor: SharedFactor
    log_evidence: float


def converged(trained: Trained | None) -> Trained | None:
    """A solution, if there is one and another step would change nothing."""
    return trained if trained is not None and trained.solution.converged else None


class Evidence:
    """Laplace approximation of the marginal likelihood of noise levels (MacKay 1992), everything integrated out.

    The sum over the records of what each says of its motion, and once what all of them say of the parameters.

    Args:
        equations: The equations of every record; one is a list of one.
        iterations: Steps at most under one noise model.
        tolerance: See :func:`minimise`.
        watch: Called with every loss term and the first record's noise model after each step.
        learn_spread: Whether the common spread of the prescribed parameters is learned.
        count: Called with the factorisations that a solution took.

    Attributes:
        records: What each says of its motion.
        equations: Of all records.
        problem: Likewise.
    """

    def __init__(
        self,
        equations: Sequence[NormalEquations],
        iterations: int,
        tolerance: float,
        watch: Callable[[dict[str, float], NoiseModel], None],
        learn_spread: bool = True,
        count: Callable[[int], None] = lambda factorisations: None,
    ) -> None:
        self.records = tuple(map(RecordEvidence, equations))
        self.equations = LeastSquares(self.records)
        self.problem = JointProblem.of(*(frame.problem for frame in equations))
        self.iterations, self.tolerance = iterations, tolerance
        self.watch, self.learn_spread, self.count = watch, learn_spread, count
        self._damping = 0.0  # where the last solution refused its undamped step: the next may as well
        self._chord: SharedFactor | None = None  # that the last step of the last solution was made with

    def train(
        self, noise: NoiseLevels, start: Point, tolerance: float | None = None, goes_on: bool = False
    ) -> Trained | None:
        """Solve under noise levels; None where the Hessian is too stiff for a Cholesky factor.

        Args:
            noise: The levels.
            start: Where to begin.
            tolerance: Of a solution that is a step on the way; None: the search's own.
            goes_on: Whether the levels differ little from those before, whose factor may serve.
        """
        watch = lambda losses: self.watch(losses, noise.records[0])  # noqa: E731
        near, self._chord = self._chord if goes_on else None, None
        limits = self.iterations, self.tolerance if tolerance is None else tolerance
        solution = minimise(self.equations, noise, start, *limits, watch, self._damping, near)
        self._damping = solution.damping
        # One is kept, and not with the solution: factors are large.
        self._chord = solution.chord if len(self.records) == 1 else None
        solution = replace(solution, chord=None)
        factor = solution.factor or self.equations.assemble(solution.point, noise).factor()
        self.count(solution.factorisations + (solution.factor is None))
        if factor is None:
            return None
        return Trained(solution, noise, factor, self.log_evidence(solution.point, noise, factor))

    def at(self, point: Point, noise: NoiseLevels) -> Trained | None:
        """A point as it is, taken for the solution, whose evidence is not worked out: NaN.

        None where the Hessian is too stiff for a Cholesky factor.
        """
        factor = self.equations.assemble(point, noise).factor()
        self.count(1)
        if factor is None:
            return None
        return Trained(Solution(point, math.nan, 0, False, 1), noise, factor, math.nan)

    def log_evidence(self, point: Point, noise: NoiseLevels, factor: SharedFactor) -> float:
        """-1/2 [chi^2 + sum of log variances + log det Hessian - log det prior] at the most probable point."""
        placed = self.equations.placed(point)
        terms = self.equations.members.each(RecordEvidence.log_evidence, placed, noise.records, factor.determinants)
        return sum(terms) + self.parameter_term(point, noise, factor)

    def parameter_term(self, point: Point, noise: NoiseLevels, factor: SharedFactor) -> float:
        """The parameters' part: their prior, and their Hessian with the readout eliminated."""
        x = point.parameters
        loss = float(np.sum((self.equations.prior_precision(noise) @ x).numpy() * x.numpy()))
        alone = float(np.sum(np.log(self.equations.precision(noise).numpy())))
        return -0.5 * (loss + factor.parameter_log_determinant - alone)

    def values(self, point: Point) -> dict[str, np.ndarray]:
        """Every parameter of the structure at a point, (members,) by kind."""
        first = self.equations.by_record[0]
        return {kind: x.numpy() for kind, x in first.parameters(self.equations.split(point)[0]).items()}

    def creates_energy(self, point: Point) -> bool:
        """Whether the hysteresis of any connection allows a cycle that gives more energy than it takes."""
        return bool(self.problem.structure.creates_energy(self.values(point)).any())

    def each_record(self, function: Callable[..., R], trained: Trained, *arguments: Sequence[Any]) -> list[R]:
        """What a function makes of every record's own part of a solution, in the order of the records.

        Args:
            function: Of a file's, of (the record's evidence, its solution, its own of every argument).
            trained: Of all records.
            arguments: Each with one entry for every record.
        """
        equations, factor, members = self.equations, trained.factor, self.equations.members
        schur, priors = [factor.schur_of(columns) for columns in equations.columns], equations.priors(trained.noise)
        placed = equations.placed(trained.solution.point)
        parts = members.keep(_part, placed, trained.noise.records, factor.eliminated, schur, priors)
        return members.each(function, parts, *arguments)

    def learned_spread(self, trained: Trained) -> float:
        """How far the prescribed parameters are off, in common; see :func:`updated_spread`."""
        believed = ~self.equations.unknown
        x = trained.solution.point.parameters.numpy()[believed]
        if not self.learn_spread or len(x) == 0:
            return trained.noise.spread
        variance = np.diag(trained.factor.corner_covariance)[believed]
        return updated_spread(x, variance, trained.noise.spread)


def _part(
    point: Point, noise: NoiseModel, eliminated: Eliminated, schur: np.ndarray, prior: np.ndarray
) -> RecordSolution:
    return RecordSolution(point, noise, BorderedFactor(schur, eliminated.readout), prior)


def model_log_evidence(evidence: Evidence, trained: Trained) -> float:
    """Natural logarithm of the density of all sensors' samples, SI units, with motion and parameters integrated out.

    NaN where the equations alone cannot be solved, or a sensor is compared with what the equations say of it.
    """
    terms = evidence.each_record(sensors_term, trained)
    return float(sum(terms)) + evidence.parameter_term(trained.solution.point, trained.noise, trained.factor)


def sensors_term(evidence: RecordEvidence, solution: RecordSolution) -> float:
    """One record's part; see :func:`model_log_evidence`."""
    equations, point, noise = evidence.equations, solution.point, solution.noise
    losses, forces = equations.losses(point, noise), evidence.force_residuals(point, noise)
    if forces.observer is not None:
        return math.nan
    (alone,) = equations.log_determinants(point, [of_motion(evidence, noise)])
    physics = float((forces.seen / noise.physics_variance)[forces.enforced].sum())
    rest = sum(value for name, value in losses.items() if name not in ("physics", *OF_PARAMETERS))
    change = solution.factor.readout.log_determinant - alone
    count = int(sum(channels.samples[channels.present].sum() for channels in equations.channels))
    return -0.5 * (physics + rest + evidence.log_variances(noise) + count * math.log(2.0 * math.pi) + change)


def left_by_motion(evidence: RecordEvidence, point: Point, noise: NoiseModel) -> float:
    """The logarithm of (det P / det H)^(1/2) at a point, with P the Hessian of the equations alone and H that of all.

    By its differences the density of parameters follows from the most probable motion of each. Traces of P^-1 would be
    quicker. But motions that the equations alone hardly know are large in it, and rounding of these is all that is left
    of them where the equations meet them.
    """
    alone, of_all = evidence.equations.log_determinants(point, [of_motion(evidence, noise), noise])
    return 0.5 * (alone - of_all)


def of_motion(evidence: RecordEvidence, noise: NoiseModel) -> NoiseModel:
    """Sensors that together say of the motion how large it is, and no more."""
    response = dict(noise.response)
    for channels in evidence.equations.channels:
        # Of each sample the deviation with which all of them together say the root mean square.
        size = channels.numbers("rms") * np.sqrt(channels.samples)
        response[channels.name] = np.where(size > 0.0, size, np.where(channels.present, 1.0, np.nan))
    return replace(noise, response=response)
