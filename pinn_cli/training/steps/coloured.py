"""Solutions under the spectrum and the level that forces that nobody measured have in the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.history import History
from pinn_cli.training.inferred import InferenceSettings, Inferred
from pinn_cli.training.levels import settled
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.steps.driving import Drive, level_in_band, spectrum_in_band

# Rounds of the spectrum of unknown forces, of the noise levels under each, and of the forces' level at the end.
COLOUR_ROUNDS, CORRELATION_ROUNDS, LEVEL_ROUNDS = 3, 3, 2


def has_forces(problem: Problem) -> bool:
    """Whether some forces were not measured."""
    return any(own.inputs.forces for own in problem.by_record)


def coloured(found: Inferred, settings: InferenceSettings, device: str, history: History) -> Inferred:
    """The solution under the most probable spectrum of the unknown forces."""
    for _ in range(COLOUR_ROUNDS):
        drives = found.evidence.each_record(spectrum_in_band, found.trained)
        if not any(drives):
            break
        again = _driven(found, drives, settings, device, history)
        if again is None:
            break
        found = again
    return found


def _driven(
    found: Inferred, drives: Sequence[Drive | None], settings: InferenceSettings, device: str, history: History
) -> Inferred | None:
    """The solution with other spectra; None of a record: as before. None where there is no solution."""
    before = replace(found.evidence.problem, alternatives=())
    problem = Problem.together([_of_spectrum(own, drive) for own, drive in zip(before.by_record, drives, strict=True)])
    networks = [own.network for own in found.evidence.equations.each]
    evidence = settings.solved_by(problem, networks, device, history)
    levels = [None if drive is None else drive.level for drive in drives]
    again = evidence.train(_with_levels(found.evidence, found.trained.noise, levels), found.trained.solution.point)
    if again is None or not again.solution.converged:
        return None
    return Inferred(evidence, settled(evidence, again, settings.pooled, CORRELATION_ROUNDS))


def _of_spectrum(problem: Problem, drive: Drive | None) -> Problem:
    if drive is None:
        return problem
    inputs = replace(problem.inputs, correlation_time=drive.correlation_time, damping_ratio=drive.damping_ratio)
    return replace(problem, inputs=inputs)


def _with_levels(evidence: Evidence, noise: NoiseLevels, levels: Sequence[float | None]) -> NoiseLevels:
    """The same noise with unknown forces of every record that are driven so much; None: as before."""
    forces = [own.dynamics.forces for own in evidence.equations.each]
    each = (
        own if level is None else own.driven_by(level, at)
        for own, level, at in zip(noise.records, levels, forces, strict=True)
    )
    return replace(noise, records=tuple(each))


def driven_in_band(evidence: Evidence, trained: Trained) -> Trained:
    """The solution with unknown forces as large as they are in the record's band."""
    if not has_forces(evidence.problem):
        return trained
    for _ in range(LEVEL_ROUNDS):
        noise = _with_levels(evidence, trained.noise, evidence.each_record(level_in_band, trained))
        again = evidence.train(noise, trained.solution.point)
        if again is None or not again.solution.converged:
            break
        trained = again
    return trained
