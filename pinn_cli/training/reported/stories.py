"""Stories of a record that the model does not quite explain, and what each predicts that it has not been shown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from pinn_cli.model.knowledge import Misfit, ParameterKnowledge
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
from pinn_cli.training.reported.posterior_estimate import posterior_estimate, with_parameters
from pinn_cli.training.solver import FreeRunning, Inference
from pinn_cli.training.steps.smooth_force import of_smooth_motion

OF_FORCE, OF_SMOOTH_FORCE, OF_RESPONSE = "force", "smooth force", "free run"
# Parts of a record that are simulated each from the estimated state at its beginning.
SEGMENTS = 10
# A story that leaves as much of every sensor as there is predicts nothing.
PREDICTS_NOTHING = 100.0
# Times what a free run misses from the first state of one motion that it may miss from that of a more probable one:
# of machines that are nearly right it was 0.9 to 2, or 45 and more where the motion was none.
STILL_PREDICTS = 3.0


def with_stories(inference: Inference, estimate: Estimate) -> Estimate:
    """The estimate with the parameters of the story that predicts the record best, and what each of them says.

    The motion is that of the more probable force: a smooth one leaves the sensors what is theirs. But a motion from
    which nothing can be predicted is none: where an accelerometer feels a floor or gravity as well, a large slow force
    would explain it, too. What the model lacks is asked of the best story without one: what a force has taken up shows
    nowhere.

    Args:
        inference: Its solutions.
        estimate: Of the story in which a force as white as the features are acts that the model leaves out.
    """
    smooth, moved, found = inference.smooth, estimate, None
    if smooth is not None:
        found = posterior_estimate(smooth.evidence, smooth.trained, smooth.solver.history)
    candidates = _candidates(inference, estimate, inference.trained.solution.point.unknowns, found)
    if found is not None and smooth is not None and smooth.trained.log_evidence > inference.trained.log_evidence:
        smoother = _with_motion(estimate, found)
        same_stories = _candidates(inference, smoother, of_smooth_motion(inference), found)
        best, same = min(zip(candidates, same_stories, strict=True), key=lambda pair: pair[0].rank)
        if same.rank < STILL_PREDICTS * best.rank:
            moved, candidates = smoother, same_stories
    free = sorted((one for one in candidates if one.name == OF_RESPONSE), key=lambda one: one.rank)
    forced = [one for one in candidates if one.name != OF_RESPONSE]
    best, *others = sorted([*forced, *free[:1]], key=lambda one: one.rank) if free else forced
    asked = next(one.trained for one in (best, *others) if one.trained is not None)
    std = [record_estimate.std for record_estimate in moved.by_record]
    lacking = inference.evidence.each_record(doubts, asked, std)
    records = zip(best.estimate.records, lacking, strict=False)
    of_records = tuple(replace(record_estimate, doubts=record_doubts) for record_estimate, record_doubts in records)
    stories = tuple(one.story for one in (best, *others)) if others else ()
    return replace(best.estimate, stories=stories, doubts=lacking[0], records=of_records)


def _candidates(
    inference: Inference, estimate: Estimate, motion: torch.Tensor, found: Estimate | None
) -> list[_Candidate]:
    """All stories with one motion; of the free run one for each solution.

    Args:
        inference: The solutions.
        estimate: Of that motion, with the parameters of a white force.
        motion: Its unknowns.
        found: Of the story of a smooth force; None: there is none.
    """
    problems = inference.evidence.problem.by_record
    forced, candidates = [estimate], [_Candidate(OF_FORCE, problems, estimate, inference.trained)]
    if found is not None:
        assert inference.smooth is not None
        assert found.correlation is not None
        assert found.known is not None
        said = found.parameters, found.correlation, found.known
        of_smooth = with_story(inference, estimate, motion, inference.smooth.trained.solution.point.parameters, said)
        forced, smooth = [estimate, found], _Candidate(OF_SMOOTH_FORCE, problems, of_smooth, None, found.summary)
        candidates.append(smooth)
    running = ((of_free_running(inference, free, estimate, motion, forced), free.trained) for free in inference.free)
    return candidates + [_Candidate(OF_RESPONSE, problems, *one) for one in running]


def _with_motion(estimate: Estimate, found: Estimate) -> Estimate:
    """The same with another motion of it, and with sensors as noisy as they are about that one.

    What acts is still what load cells and what the model leaves out say together.
    """

    def moved(before: Estimate, after: Estimate) -> Estimate:
        return replace(
            before,
            response=replace(after.response, force=before.response.force),
            std=replace(after.std, force=before.std.force),
            connections=after.connections,
            left=after.left,
            noise=replace(after.noise, discrepancy=before.noise.discrepancy),
            of_motion=tuple(after.parameters),
        )

    pairs = zip(estimate.records, found.records, strict=True)
    return replace(moved(estimate, found), records=tuple(moved(before, after) for before, after in pairs))


def of_free_running(
    inference: Inference, free: FreeRunning, estimate: Estimate, motion: torch.Tensor, forced: Sequence[Estimate]
) -> Estimate:
    """The same motion, with the parameters of the structure that runs free, and the force that it then takes.

    No record averages out how the parameters vary, nor what the other stories, ``forced``, say of them.
    """
    equations, varying = inference.evidence.equations, np.hypot(free.varying, story_distance(inference, free, forced))
    misfit = varying, np.ones(len(varying))
    parameters, correlation, known = parameter_posterior(equations, free.trained, misfit, free.covariance)
    # Means that a bound moves are no longer what makes the structure run.
    at = free.trained.solution.point.parameters
    modes = np.maximum(at.numpy(), equations.lower) * equations.scale
    parameters = [_at_mode(p, p.parameter.value(float(x))) for p, x in zip(parameters, modes, strict=False)]
    return with_story(inference, estimate, motion, at, (parameters, correlation, known))


def with_story(
    inference: Inference,
    estimate: Estimate,
    motion: torch.Tensor,
    at: torch.Tensor,
    posterior: tuple[list[ParameterEstimate], np.ndarray, ParameterKnowledge],
) -> Estimate:
    """The same motion, with the parameters of another story, and the force that it then takes.

    Args:
        inference: Whose story it is.
        estimate: Of a motion.
        motion: Its unknowns.
        at: (p,), those parameters, in prior standard deviations from the prescribed ones.
        posterior: What is said of them, see :func:`parameter_posterior`.
    """
    pairs = zip(estimate.by_record, _left_out(inference, motion, at), strict=True)
    changed_estimate = with_parameters(
        inference.evidence, [replace(record_estimate, misfit=misfit) for record_estimate, misfit in pairs], posterior
    )
    changed = {name: getattr(changed_estimate, name) for name in ("parameters", "correlation", "known", "misfit")}
    before = [tuple(record_estimate.of_motion or record_estimate.parameters) for record_estimate in estimate.by_record]
    records = zip(changed_estimate.records, before, strict=False)
    of_records = tuple(replace(record_estimate, of_motion=motion) for record_estimate, motion in records)
    return replace(estimate, **changed, records=of_records, of_motion=before[0])


def _left_out(inference: Inference, motion: torch.Tensor, at: torch.Tensor) -> list[Misfit]:
    """The force that a motion takes with some parameters, of every record."""
    trained = inference.trained
    moved = replace(trained, solution=replace(trained.solution, point=Point(motion, at)))
    return inference.evidence.each_record(misfit_history, moved)


def story_distance(inference: Inference, free: FreeRunning, forced: Sequence[Estimate]) -> np.ndarray:
    """(p,), how far the stories of a force are from that of a free run, in prior deviations; of them the furthest.

    Beyond what both allow for. A spring that changes with time moves the one by a small part of what it moves the
    other: both cannot be right.
    """
    at, scale = free.trained.solution.point.parameters.numpy(), inference.evidence.equations.scale
    own, beyond = np.diag(free.covariance) + free.varying**2, np.zeros(len(at))
    for estimate in forced:
        # A first state is no parameter, and comes last.
        kept = slice(len(estimate.parameters))
        values = np.array([(p.estimate - p.parameter.prescribed, p.std) for p in estimate.parameters]).T / scale[kept]
        beyond[kept] = np.maximum(beyond[kept], (at[kept] - values[0]) ** 2 - values[1] ** 2 - own[kept])
    return np.sqrt(beyond)


def _at_mode(parameter: ParameterEstimate, mode: float) -> ParameterEstimate:
    lower, upper = min(parameter.lower_90, mode), max(parameter.upper_90, mode)
    return replace(parameter, estimate=mode, lower_90=lower, upper_90=upper)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A story, and what it misses of the response's sensors of all records: a mean NMSE, %.

    Attributes:
        name: Of the story.
        problems: Of every record.
        estimate: With its parameters.
        trained: Its solution, where no force is free in it.
        summary: Of one in which a force is.
    """

    name: str
    problems: Sequence[Problem]
    estimate: Estimate
    trained: Trained | None
    summary: Mapping[str, Any] = field(default_factory=dict)

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
        force = (self.summary.get(name, math.nan) for name in ("std_unknown_force", "correlation_time_unknown_force"))
        return Story(self.name, tuple(self.estimate.parameters), self.free_run, self.segments, *force)

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
