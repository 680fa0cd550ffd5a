"""Solutions under the band, the spectrum and the level that forces that nobody measured have in the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.evidence import Evidence
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.first_solution import first_solution
from pinn_cli.training.steps.force_spectrum import Drive, level_in_band, reaches_beyond, spectrum_in_band

# Rounds of the noise levels under each spectrum.
CORRELATION_ROUNDS = 3


def widen_force_band(inference: Inference) -> Inference | None:
    """The solution with unknown forces that reach as far as they do, see :func:`reaches_beyond`; None: they do."""
    factors, solver = inference.evidence.each_record(reaches_beyond, inference.trained), inference.solver
    if max(factors) <= 1.0:
        return None
    records = list(zip(solver.designs, factors, inference.problem, strict=True))
    designs = tuple(design.finer(factor, record_problem.record) for design, factor, record_problem in records)
    if not all(designs):
        return None
    problem = JointProblem.of(*(_of_wider_band(record_problem, factor) for _, factor, record_problem in records))
    return first_solution(problem, replace(solver, designs=designs))  # type: ignore[arg-type]


def _of_wider_band(problem: Problem, factor: float) -> Problem:
    inputs = problem.inputs
    wider = replace(inputs, edge=inputs.edge * factor, correlation_time=inputs.correlation_time / factor)
    return replace(problem, inputs=wider)


def fit_force_spectrum(inference: Inference) -> Inference | None:
    """The solution under the most probable spectrum of the unknown forces; None where it has that already."""
    drives = inference.evidence.each_record(spectrum_in_band, inference.trained)
    if not any(drives):
        return None
    pairs = zip(inference.problem, drives, strict=True)
    problem = JointProblem.of(*(of_spectrum(record_problem, drive) for record_problem, drive in pairs))
    evidence = inference.solver.evidence(
        problem, [equations.network for equations in inference.evidence.equations.by_record]
    )
    levels = [None if drive is None else drive.levels for drive in drives]
    again = evidence.train(
        _with_levels(inference.evidence, inference.trained.noise, levels), inference.trained.solution.point
    )
    if again is None or not again.solution.converged:
        return None
    return replace(inference, evidence=evidence, trained=inference.solver.settled(evidence, again, CORRELATION_ROUNDS))


def of_spectrum(problem: Problem, drive: Drive | None) -> Problem:
    """The same problem with unknown forces of such a spectrum; None: of their own."""
    if drive is None:
        return problem
    inputs = replace(problem.inputs, correlation_time=drive.correlation_time, damping_ratio=drive.damping_ratio)
    return replace(problem, inputs=inputs)


def set_force_level(inference: Inference) -> Inference | None:
    """The solution with unknown forces as large as they are in their band; None without any."""
    if not inference.problem.has_unknown_forces:
        return None
    levels = inference.evidence.each_record(level_in_band, inference.trained)
    again = inference.evidence.train(
        _with_levels(inference.evidence, inference.trained.noise, levels), inference.trained.solution.point
    )
    return replace(inference, trained=again) if again is not None and again.solution.converged else None


def _with_levels(evidence: Evidence, noise: NoiseLevels, levels: Sequence[np.ndarray | None]) -> NoiseLevels:
    """The same noise with unknown forces of every record that are driven so much; None: as before."""
    forces = [equations.dynamics.forces for equations in evidence.equations.by_record]
    driven = (
        record_noise if level is None else record_noise.driven_by(level, at)
        for record_noise, level, at in zip(noise.records, levels, forces, strict=True)
    )
    return replace(noise, records=tuple(driven))
