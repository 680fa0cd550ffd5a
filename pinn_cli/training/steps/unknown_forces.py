"""Solutions under the band, the spectrum and the level that forces that nobody measured have in the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.evidence import Evidence
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.first_solution import first_solution
from pinn_cli.training.steps.force_spectrum import Drive, level_in_band, reaches_beyond, spectrum_in_band

# Rounds of the noise levels under each spectrum.
CORRELATION_ROUNDS = 3


def widen_force_band(found: Inference) -> Inference | None:
    """The solution with unknown forces that reach as far as they do, see :func:`reaches_beyond`; None: they do."""
    factors, solver = found.evidence.each_record(reaches_beyond, found.trained), found.solver
    if max(factors) <= 1.0:
        return None
    each = list(zip(solver.designs, factors, found.problem, strict=True))
    designs = tuple(design.finer(factor, own.record) for design, factor, own in each)
    if not all(designs):
        return None
    problem = JointProblem.of(*(_of_wider_band(own, factor) for _, factor, own in each))
    return first_solution(problem, replace(solver, designs=designs))  # type: ignore[arg-type]


def _of_wider_band(problem: Problem, factor: float) -> Problem:
    inputs = problem.inputs
    wider = replace(inputs, edge=inputs.edge * factor, correlation_time=inputs.correlation_time / factor)
    return replace(problem, inputs=wider)


def fit_force_spectrum(found: Inference) -> Inference | None:
    """The solution under the most probable spectrum of the unknown forces; None where it has that already."""
    drives = found.evidence.each_record(spectrum_in_band, found.trained)
    if not any(drives):
        return None
    pairs = zip(found.problem, drives, strict=True)
    problem = JointProblem.of(*(_of_spectrum(own, drive) for own, drive in pairs))
    evidence = found.solver.evidence(problem, [own.network for own in found.evidence.equations.each])
    levels = [None if drive is None else drive.level for drive in drives]
    again = evidence.train(_with_levels(found.evidence, found.trained.noise, levels), found.trained.solution.point)
    if again is None or not again.solution.converged:
        return None
    return replace(found, evidence=evidence, trained=found.solver.settled(evidence, again, CORRELATION_ROUNDS))


def _of_spectrum(problem: Problem, drive: Drive | None) -> Problem:
    if drive is None:
        return problem
    inputs = replace(problem.inputs, correlation_time=drive.correlation_time, damping_ratio=drive.damping_ratio)
    return replace(problem, inputs=inputs)


def set_force_level(found: Inference) -> Inference | None:
    """The solution with unknown forces as large as they are in the record's band; None without any."""
    if not found.problem.has_unknown_forces:
        return None
    levels = found.evidence.each_record(level_in_band, found.trained)
    again = found.evidence.train(
        _with_levels(found.evidence, found.trained.noise, levels), found.trained.solution.point
    )
    return replace(found, trained=again) if again is not None and again.solution.converged else None


def _with_levels(evidence: Evidence, noise: NoiseLevels, levels: Sequence[float | None]) -> NoiseLevels:
    """The same noise with unknown forces of every record that are driven so much; None: as before."""
    forces = [own.dynamics.forces for own in evidence.equations.each]
    each = (
        own if level is None else own.driven_by(level, at)
        for own, level, at in zip(noise.records, levels, forces, strict=True)
    )
    return replace(noise, records=tuple(each))
