"""Stories of a record that the model does not quite explain, and what each predicts that it has not been shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import NoFreeRunError, free_run_of
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.calibrated_record import as_run
from pinn_cli.training.doubts.doubts import doubts
from pinn_cli.training.estimate import Estimate, ParameterEstimate, Story
from pinn_cli.training.estimated_structure import estimated_structure
from pinn_cli.training.evidence import Trained
from pinn_cli.training.point import Point
from pinn_cli.training.reported.misfit_history import misfit_history
from pinn_cli.training.reported.parameter_posterior import parameter_posterior
from pinn_cli.training.reported.posterior_estimate import with_parameters
from pinn_cli.training.solver import FreeRunning, Inference

OF_FORCE, OF_RESPONSE = "force", "free run"
# Parts of a record that are simulated each from the estimated state at its beginning.
SEGMENTS = 10
# A story that leaves as much of every sensor as there is predicts nothing.
PREDICTS_NOTHING = 100.0


def with_stories(inference: Inference, estimate: Estimate) -> Estimate:
    """The estimate with the parameters of the story that predicts the record best, and what each of them says.

    What the model lacks is asked of that story: what no force has taken up is left where it shows.

    Args:
        inference: Its solutions.
        estimate: Of the story in which a force acts that the model leaves out; its motion is that in any case.
    """
    problems = inference.evidence.problem.by_record
    best = _Candidate(OF_FORCE, problems, estimate, inference.trained)
    stories: tuple[Story, ...] = ()
    if inference.free:
        free = min(
            (
                _Candidate(OF_RESPONSE, problems, of_free_running(inference, free, estimate), free.trained)
                for free in inference.free
            ),
            key=lambda candidate: candidate.rank,
        )
        best, other = sorted((best, free), key=lambda candidate: candidate.rank)
        stories = best.story, other.story
    lacking = inference.evidence.each_record(
        doubts, best.trained, [record_estimate.std for record_estimate in estimate.by_record]
    )
    records = zip(best.estimate.records, lacking, strict=False)
    of_records = tuple(replace(record_estimate, doubts=record_doubts) for record_estimate, record_doubts in records)
    return replace(best.estimate, stories=stories, doubts=lacking[0], records=of_records)


def of_free_running(inference: Inference, free: FreeRunning, estimate: Estimate) -> Estimate:
    """The same motion, with the parameters of the structure that runs free, and the force that it then takes.

    No record averages out how the parameters vary, nor what the other story says of them.
    """
    equations, varying = inference.evidence.equations, np.hypot(free.varying, story_distance(inference, free, estimate))
    misfit = varying, np.ones(len(varying))
    parameters, correlation, known = parameter_posterior(equations, free.trained, misfit, free.covariance)
    # Means that a bound moves are no longer what makes the structure run.
    modes = np.maximum(free.trained.solution.point.parameters.numpy(), equations.lower) * equations.scale
    parameters = [_at_mode(p, p.parameter.value(float(x))) for p, x in zip(parameters, modes, strict=False)]
    point = Point(inference.trained.solution.point.unknowns, free.trained.solution.point.parameters)
    moved = replace(inference.trained, solution=replace(inference.trained.solution, point=point))
    pairs = zip(estimate.by_record, inference.evidence.each_record(misfit_history, moved), strict=True)
    changed_estimate = with_parameters(
        inference.evidence,
        [replace(record_estimate, misfit=misfit) for record_estimate, misfit in pairs],
        (parameters, correlation, known),
    )
    changed = {name: getattr(changed_estimate, name) for name in ("parameters", "correlation", "known", "misfit")}
    first, *_ = motions = [tuple(record_estimate.parameters) for record_estimate in estimate.by_record]
    records = zip(changed_estimate.records, motions, strict=False)
    of_records = tuple(replace(record_estimate, of_motion=motion) for record_estimate, motion in records)
    return replace(estimate, **changed, records=of_records, of_motion=first)


def story_distance(inference: Inference, free: FreeRunning, estimate: Estimate) -> np.ndarray:
    """(p,), how far the story of a force is from that of a free run, in prior deviations, beyond what both allow for.

    A spring that changes with time moves the one by a small part of what it moves the other: both cannot be right.
    """
    at, scale = free.trained.solution.point.parameters.numpy(), inference.evidence.equations.scale
    # A first state is no parameter, and comes last.
    kept = slice(len(estimate.parameters))
    estimates = np.array([(p.estimate - p.parameter.prescribed, p.std) for p in estimate.parameters]).T / scale[kept]
    beyond = np.zeros(len(at))
    beyond[kept] = (
        (at[kept] - estimates[0]) ** 2 - estimates[1] ** 2 - (np.diag(free.covariance) + free.varying**2)[kept]
    )
    return np.sqrt(np.maximum(beyond, 0.0))


def _at_mode(parameter: ParameterEstimate, mode: float) -> ParameterEstimate:
    lower, upper = min(parameter.lower_90, mode), max(parameter.upper_90, mode)
    return replace(parameter, estimate=mode, lower_90=lower, upper_90=upper)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A story, and what it misses of the response's sensors of all records: a mean NMSE, %."""

    name: str
    problems: Sequence[Problem]
    estimate: Estimate
    trained: Trained

    @cached_property
    def free_run(self) -> float:
        return self._missed(1)

    @cached_property
    def segments(self) -> float:
        return self._missed(SEGMENTS)

    @property
    def rank(self) -> float:
        """What decides: the free run, else its segments where it goes nowhere."""
        return self.free_run if self.free_run < PREDICTS_NOTHING else PREDICTS_NOTHING + self.segments

    @property
    def story(self) -> Story:
        return Story(self.name, tuple(self.estimate.parameters), self.free_run, self.segments)

    def _missed(self, parts: int) -> float:
        records = zip(self.problems, self.estimate.by_record, strict=True)
        return float(np.mean([_missed_of(problem, estimate, parts) for problem, estimate in records]))


def _missed_of(problem: Problem, estimate: Estimate, parts: int) -> float:
    """Of one record, in so many parts; infinite where there is no free run."""
    record, motion = as_run(problem.record, estimate), estimate.response
    structure = estimated_structure(problem.structure, estimate.parameters)
    ends, total = np.linspace(0, len(record.time), parts + 1).astype(int).tolist(), []
    for first, last in pairwise(ends):
        try:
            response = free_run_of(structure, record.until(last), motion, first, first)
        except NoFreeRunError:
            return np.inf
        total.append(_squares(record, response, slice(first, last)))
    return 100.0 * float(np.mean(np.sum(total, axis=0) / _powers(record)))


def _squares(record: Record, response: Response, part: slice) -> np.ndarray:
    """(C,) sum of squares of what a simulation leaves of every channel in a part of the record."""
    out = []
    for channel in channels(record):
        residual = channel.measured[part] - channel.of(response)
        out.append(float(np.sum(residual[channel.there[part]] ** 2)))
    return np.array(out)


def _powers(record: Record) -> np.ndarray:
    """(C,) sum of squares of every channel about its mean."""
    samples = [channel.measured[channel.there] for channel in channels(record)]
    return np.array([float(np.sum((x - x.mean()) ** 2)) for x in samples])
