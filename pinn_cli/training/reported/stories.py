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

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import NoFreeRunError, free_run_of
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.left_out import PLACE
from pinn_cli.training.calibrated_record import as_run
from pinn_cli.training.doubts.doubts import LEAST_LEVEL, doubts, rms_force
from pinn_cli.training.estimate import Doubt, Estimate, ParameterEstimate, Story, estimated_structure
from pinn_cli.training.evidence import Trained
from pinn_cli.training.minimise import Point
from pinn_cli.training.reported.parameter_posterior import parameter_posterior
from pinn_cli.training.reported.posterior_estimate import misfit_history, posterior_estimate, with_parameters
from pinn_cli.training.solver import FreeRunning, Inference
from pinn_cli.training.steps.smooth_force import of_smooth_motion, place_of

OF_FORCE, OF_SMOOTH_FORCE, OF_RESPONSE = "force", "smooth force", "free run"
# Parts of a record that are simulated each from the estimated state at its beginning.
SEGMENTS = 10
# A story that leaves as much of every sensor as there is predicts nothing.
PREDICTS_NOTHING = 100.0
# Times what a free run misses from the first state of one motion that it may miss from that of a more probable one:
# of machines that are nearly right it was 0.9 to 2, or 45 and more where the motion was none.
STILL_PREDICTS = 3.0
# Share of what the model leaves out from which on doubts explain it, and its place is not told beside them.
EXPLAINED = 0.5


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
    smooth, motion = inference.smooth, inference.trained.solution.point.unknowns
    found = None if smooth is None else posterior_estimate(smooth.evidence, smooth.trained, smooth.solver.history)
    candidates = _candidates(inference, estimate, found)
    if found is not None and found.summary["model_log_evidence"] > estimate.summary["model_log_evidence"]:
        smoother = _with_motion(estimate, found)
        same_stories = [replace(one, moved=smoother) for one in candidates]
        best, same = min(zip(candidates, same_stories, strict=True), key=lambda pair: pair[0].rank)
        if same.rank < STILL_PREDICTS * best.rank:
            candidates, motion = same_stories, of_smooth_motion(inference)
    free = sorted((one for one in candidates if one.name == OF_RESPONSE), key=lambda one: one.rank)
    forced = [one for one in candidates if one.name != OF_RESPONSE]
    best, *others = sorted([*forced, *free[:1]], key=lambda one: one.rank) if free else forced
    asked = next(one.trained for one in (best, *others) if one.trained is not None)
    reported = best.estimate if best.said is None else _with_force_left(inference, best, motion)
    std, parameters = zip(*((of_record.std, of_record.parameters) for of_record in reported.by_record), strict=True)
    lacking = inference.evidence.each_record(doubts, asked, std, parameters)
    place = () if found is None or smooth is None else _of_place(smooth, found, reported)
    lacking = [of_record if explain_most(of_record) else (*of_record, *place) for of_record in lacking]
    records = zip(reported.records, lacking, strict=False)
    of_records = tuple(replace(record_estimate, doubts=record_doubts) for record_estimate, record_doubts in records)
    stories = tuple(one.story for one in (best, *others)) if others else ()
    return replace(reported, stories=stories, doubts=lacking[0], records=of_records)


def explain_most(found: Sequence[Doubt]) -> bool:
    """Whether these are most of what the model leaves out."""
    return math.fsum(doubt.share for doubt in found) > EXPLAINED


def _of_place(smooth: Inference, found: Estimate, reported: Estimate) -> tuple[Doubt, ...]:
    """That a smooth force acts on one DOF alone; nothing where it does not, or is nothing beside the connections'."""
    level = found.summary["std_unknown_force"]
    if not (of := place_of(smooth)) or level < LEAST_LEVEL * rms_force(*smooth.by_record[0]):
        return ()
    pairs = zip(found.parameters, reported.parameters, strict=True)
    moves = {ours.name: abs(one.estimate - ours.estimate) / ours.std for one, ours in pairs if ours.unknown}
    moved = max(moves, key=lambda name: moves[name])
    return (Doubt(PLACE, of, level, math.nan, "N", smooth.log_odds_of_place, moves[moved], moved),)


def _candidates(inference: Inference, estimate: Estimate, found: Estimate | None) -> list[_Candidate]:
    """All stories: of a white force, of a smooth one where it was ``found``, and of every solution that runs free."""
    forced, candidates = [estimate], [_Candidate(OF_FORCE, inference, estimate, inference.trained)]
    if found is not None:
        assert inference.smooth is not None
        assert found.correlation is not None
        assert found.known is not None
        said = Said(inference.smooth.trained.solution.point, found.parameters, found.correlation, found.known)
        forced.append(found)
        candidates.append(_Candidate(OF_SMOOTH_FORCE, inference, estimate, None, said, found.summary))
    for free in inference.free:
        said = of_free_running(inference, free, forced)
        candidates.append(_Candidate(OF_RESPONSE, inference, estimate, free.trained, said))
    return candidates


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


def of_free_running(inference: Inference, free: FreeRunning, forced: Sequence[Estimate]) -> Said:
    """The parameters of the structure that runs free.

    No record averages out how they vary, nor what the other stories, ``forced``, say of them.
    """
    equations, varying = inference.evidence.equations, np.hypot(free.varying, story_distance(inference, free, forced))
    misfit = varying, np.ones(len(varying))
    parameters, correlation, known = parameter_posterior(equations, free.trained, misfit, free.covariance)
    # Means that a bound moves are no longer what makes the structure run.
    point = free.trained.solution.point
    modes = np.maximum(point.parameters.numpy(), equations.lower) * equations.scale
    parameters = [_at_mode(p, p.parameter.value(float(x))) for p, x in zip(parameters, modes, strict=False)]
    return Said(point, parameters, correlation, known)


def _with_story(inference: Inference, estimate: Estimate, said: Said) -> Estimate:
    """The same motion, with the parameters of another story."""
    of_records = [replace(one, of_motion=tuple(one.of_motion or one.parameters)) for one in estimate.by_record]
    changed = with_parameters(inference.evidence, of_records, (said.parameters, said.correlation, said.known))
    return replace(changed, disagreements=estimate.disagreements)


def _with_force_left(inference: Inference, story: _Candidate, motion: torch.Tensor) -> Estimate:
    """The estimate of a story with the force that its motion, of these unknowns, takes with its parameters."""
    trained, estimate = inference.trained, story.estimate
    assert story.said is not None
    point = Point(motion, story.said.point.parameters)
    moved = replace(trained, solution=replace(trained.solution, point=point))
    left_out = inference.evidence.each_record(misfit_history, moved)
    records = zip(estimate.records, left_out, strict=False)
    of_records = tuple(replace(record_estimate, misfit=misfit) for record_estimate, misfit in records)
    return replace(estimate, misfit=left_out[0], records=of_records)


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
class Said:
    """What a story says of the parameters.

    Attributes:
        point: Of its solution.
        parameters, correlation, known: See :class:`Estimate`.
    """

    point: Point
    parameters: list[ParameterEstimate]
    correlation: np.ndarray
    known: ParameterKnowledge


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A story, and what it misses of the response's sensors of all records: a mean NMSE, %.

    Attributes:
        name: Of the story.
        inference: The solutions.
        moved: Of a motion, with the parameters of a white force.
        trained: Its solution, where no smooth force is in it.
        said: Its parameters; None: those of a white force.
        summary: Of a smooth force.
    """

    name: str
    inference: Inference
    moved: Estimate
    trained: Trained | None
    said: Said | None = None
    summary: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def estimate(self) -> Estimate:
        """The motion with these parameters; the force that is left out is still that of a white one."""
        return self.moved if self.said is None else _with_story(self.inference, self.moved, self.said)

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
        level, time = (self.summary.get(f"{of}_unknown_force", math.nan) for of in ("std", "correlation_time"))
        smooth = self.inference.smooth if self.name == OF_SMOOTH_FORCE else None
        place = "" if smooth is None else place_of(smooth)
        return Story(self.name, tuple(self.estimate.parameters), self.free_run, self.segments, level, time, place)

    def _missed(self, parts: int) -> float:
        records = zip(self.inference.evidence.problem.by_record, self.estimate.by_record, strict=True)
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
