"""The search for the model error that makes a record, or several together, most probable."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.band.bordered import BorderedFactor
from pinn_cli.training.band.levenberg_marquardt import LeastSquares, Solution, minimise
from pinn_cli.training.band.point import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.parameter_spread import updated_spread

R = TypeVar("R")

# The scan over the discrepancy goes down by this factor: half a decade, fine enough for a parabola through three
# points.
SCAN_FACTOR = 10.0**0.5
# Where the evidence rises by more than this from one solution to the next, the peak is far: then steps are twice as
# long, while they take no more than so many factorisations.
FAR_FROM_THE_PEAK, EASILY_FOLLOWED = 200.0, 3
# A drop of the log evidence by this much ends the scan: the odds against anything stiffer are e^-20.
DECISIVE_DROP = 20.0
# The scan also ends after this many steps without a gain, or at this fraction of the force that it began with.
PATIENCE, FINEST_DISCREPANCY = 3, 1e-8
# A discrepancy below this part of the noise of every measured input makes no motion better known: one step without a
# gain ends the scan there.
FINEST_OF_NOISE = 1e-2
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

    def drawn(self, count: int, of_mean_length: bool = False) -> list[Point]:
        """Draws from the posterior, as steps from the solution; the same ones every time.

        Args:
            count: How many.
            of_mean_length: Whether each is as long as a draw is on average: few of them then add up to what they must.
        """
        size = self.factor.size
        normals = np.random.default_rng(0).standard_normal((size, count))
        if of_mean_length:
            normals *= np.sqrt(size) / np.linalg.norm(normals, axis=0)
        weights, parameters = self.factor.draws(normals)
        like = self.solution.point.unknowns
        return [
            Point(*(torch.as_tensor(x).to(like) for x in drawn)) for drawn in zip(weights.T, parameters.T, strict=True)
        ]


class DiscrepancySearch(ABC):
    """From solutions under given noise models to the most probable one.

    Args:
        equations: The least-squares problem.
        iterations: Steps at most under one noise model.
        tolerance: See :func:`minimise`.
        watch: Called with every loss term and the noise model after each step.
        learn_spread: Whether the common spread of the prescribed parameters is learned.
        count: Called with the factorisations that a solution took.
    """

    def __init__(
        self,
        equations: LeastSquares,
        iterations: int,
        tolerance: float,
        watch: Callable[[dict[str, float], NoiseModel], None],
        learn_spread: bool = True,
        count: Callable[[int], None] = lambda factorisations: None,
    ) -> None:
        self.least_squares, self.iterations, self.tolerance = equations, iterations, tolerance
        self.watch, self.learn_spread, self.count = watch, learn_spread, count
        self._is_cautious = False  # whether the last solution refused its undamped step: the next may as well
        self._chord: BorderedFactor | None = None  # that the last step of the last solution was made with

    @property
    @abstractmethod
    def unknown(self) -> np.ndarray:
        """(p,) bool, the uncertain parameters that are to be identified; the others are believed."""

    @abstractmethod
    def log_evidence(self, point: Point, noise: NoiseModel, factor: BorderedFactor) -> float:
        """-1/2 [chi^2 + sum of log variances + log det Hessian - log det prior] at the most probable point."""

    @abstractmethod
    def each_record(self, function: Callable[..., R], trained: Trained, *arguments: Sequence[Any]) -> list[R]:
        """What a function makes of every record's own part of a solution, in the order of the records.

        Args:
            function: Of a file's, of (evidence of the record, solution of the record, its own of every argument).
            trained: Of all records.
            arguments: Each with one entry for every record.
        """

    @abstractmethod
    def occupied(self, trained: Trained) -> list[float]:
        """Of every record the share of the features' band that the discrepancy fills."""

    def train(
        self, noise: NoiseModel, start: Point, tolerance: float | None = None, goes_on: bool = False
    ) -> Trained | None:
        """Solve under a noise model; None where the Hessian is too stiff for a Cholesky factor.

        Args:
            noise: The model.
            start: Where to begin.
            tolerance: Of a solution that is a step on the way; None: the search's own.
            goes_on: Whether the model differs little from the one before, whose factor may serve.
        """
        enough = self.tolerance if tolerance is None else tolerance
        watch = lambda losses: self.watch(losses, noise)  # noqa: E731
        near, self._chord = self._chord if goes_on else None, None
        limits = self.iterations, enough
        solution = minimise(self.least_squares, noise, start, *limits, watch, self._is_cautious, near)
        self._is_cautious = solution.cautious
        # One is kept, and not with the solution: factors are large.
        self._chord = solution.chord if self.least_squares.keeps_factors else None
        solution = replace(solution, chord=None)
        factor = solution.factor or self.least_squares.assemble(solution.point, noise).factor()
        self.count(solution.factorisations + (solution.factor is None))
        if factor is None:
            return None
        return Trained(solution, noise, factor, self.log_evidence(solution.point, noise, factor))

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
        found = self.scan(noise, force, self.least_squares.start(), refined)
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
        tried: list[tuple[float, float]] = []  # of each the discrepancy and the log evidence: factors are large
        point, discrepancy, idle, stride = start, largest, 0, SCAN_FACTOR
        best: Trained | None = None
        indifferent = FINEST_OF_NOISE * noise.least_of_inputs
        while discrepancy > FINEST_DISCREPANCY * largest and idle < PATIENCE:
            trained = self.train(noise.with_discrepancy(discrepancy), point)
            followed = best is not None and best.solution.converged
            failed = trained is None or (followed and not trained.solution.converged)
            lower = trained is not None and best is not None and trained.log_evidence < best.log_evidence
            if stride > SCAN_FACTOR and (failed or lower):  # beyond what can be followed, or beyond the peak
                discrepancy, stride = discrepancy * stride / SCAN_FACTOR, SCAN_FACTOR
                continue
            if trained is None or failed:
                break  # stiffer than these steps or these numbers can follow
            stride = SCAN_FACTOR**2 if best is not None and _is_easy(best, trained) else SCAN_FACTOR
            tried.append((trained.noise.discrepancy, trained.log_evidence))
            point, noise = trained.solution.point, noise.with_spread(self.learned_spread(trained))
            idle = 0 if best is None or trained.log_evidence > best.log_evidence else idle + 1
            best = trained if best is None or idle == 0 else best
            if trained.log_evidence < best.log_evidence - DECISIVE_DROP or (idle and discrepancy < indifferent):
                break
            discrepancy /= stride
            del trained  # before the next is made
        if best is None:
            raise DivergenceError(
                "the softest physics already has a singular normal matrix; use fewer knots or more sensors"
            )
        return self._settle_spread(self._refine(tried, best)) if refined else best

    def _refine(self, tried: list[tuple[float, float]], best: Trained) -> Trained:
        """Close in on the most probable discrepancy by parabolas through the best and its neighbours."""
        for _ in range(REFINEMENTS):
            tried.sort()
            middle = tried.index((best.noise.discrepancy, best.log_evidence))
            if not 0 < middle < len(tried) - 1:
                break
            top = _parabola_top(tried[middle - 1 : middle + 2])
            if top is None or top[1] - best.log_evidence < NEGLIGIBLE_GAIN:
                break
            trained = self.train(best.noise.with_discrepancy(top[0]), best.solution.point)
            if trained is None or not trained.solution.converged:
                break
            tried.append((trained.noise.discrepancy, trained.log_evidence))
            best = max(best, trained, key=lambda candidate: candidate.log_evidence)
        return best

    def widen_for_colour(self, trained: Trained) -> Trained:
        """Solve once more with the discrepancy that its own colour asks for.

        The search takes the discrepancy for K independent values per DOF. A model error that fills only part of the
        features' band has fewer, N_eff, and larger ones; counting K of them makes states look better known than they
        are. N_eff / K is the bandwidth of the physics residual, (sum S)^2 / (M sum S^2), over the M frequencies that
        the features follow.
        """
        levels = zip(trained.noise.by_record, self.occupied(trained), strict=True)
        noise = NoiseModel.of_records([level.widened(share) for level, share in levels])
        wider = self.train(noise, trained.solution.point)
        return wider if wider is not None and wider.solution.converged else trained

    def learned_spread(self, trained: Trained) -> float:
        """How far the prescribed parameters are off, in common; see :func:`updated_spread`."""
        believed = ~self.unknown
        x = trained.solution.point.parameters.cpu().numpy()[believed]
        if not self.learn_spread or len(x) == 0:
            return trained.noise.spread
        variance = np.diag(trained.factor.corner_covariance)[believed]
        return updated_spread(x, variance, trained.noise.spread)

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


def _is_easy(before: Trained, after: Trained | None) -> bool:
    """Whether a scan that goes on like that is still far from the peak, and may take longer steps to it."""
    if after is None or not (before.solution.converged and after.solution.converged):
        return False
    rise = after.log_evidence - before.log_evidence
    return rise > FAR_FROM_THE_PEAK and after.solution.factorisations <= EASILY_FOLLOWED and not after.solution.cautious


def _parabola_top(three: list[tuple[float, float]]) -> tuple[float, float] | None:
    """Discrepancy and log evidence at the top of the parabola through three of them; None where it opens upwards."""
    x = np.log([discrepancy for discrepancy, _ in three])
    curvature, slope, level = np.polyfit(x - x[1], [log_evidence for _, log_evidence in three], 2)
    if curvature >= 0:
        return None
    # A lopsided peak throws the parabola onto a neighbour: stay inside.
    offset = np.clip(-0.5 * slope / curvature, 0.9 * (x[0] - x[1]), 0.9 * (x[2] - x[1]))
    return float(np.exp(x[1] + offset)), float(level + offset * (slope + curvature * offset))
