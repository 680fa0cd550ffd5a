"""Solutions under the band, the spectrum and the level that forces that nobody measured have in the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.evidence import Evidence, Trained, converged
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
    records = zip(solver.designs, factors, inference.problem, strict=True)
    designs = tuple(design.finer(factor, record_problem.record) for design, factor, record_problem in records)
    if not all(designs):
        return None

    def wider(problem: Problem, factor: float) -> Problem:
        edge, correlation_time = problem.inputs.edge * factor, problem.inputs.correlation_time / factor
        return replace(problem, inputs=replace(problem.inputs, edge=edge, correlation_time=correlation_time))

    again = replace(solver, designs=designs)  # type: ignore[arg-type]
    return first_solution(inference.problem.changed(wider, factors), again)


def fit_force_spectrum(inference: Inference) -> Inference | None:
    """The solution under the most probable spectrum of the unknown forces; None where it has that already."""
    drives = inference.evidence.each_record(spectrum_in_band, inference.trained)
    if not any(drives):
        return None
    solver, networks = inference.solver, [equations.network for equations in inference.evidence.equations.by_record]
    evidence = solver.evidence(inference.problem.changed(of_spectrum, drives), networks)
    again = _driven(inference, evidence, [None if drive is None else drive.levels for drive in drives])
    if again is None:
        return None
    return replace(inference, evidence=evidence, trained=solver.settled(evidence, again, CORRELATION_ROUNDS))


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
    again = _driven(inference, inference.evidence, levels)
    return None if again is None else replace(inference, trained=again)


def _driven(inference: Inference, evidence: Evidence, levels: Sequence[np.ndarray | None]) -> Trained | None:
    """The solution with unknown forces of every record that are driven so much, None: as before; None: there is none.

    Args:
        inference: The solution before.
        evidence: Of a problem with the same functions.
        levels: (forces,), of every record.
    """
    noise, by_record = inference.trained.noise, inference.evidence.equations.by_record
    driven = (
        record_noise if level is None else record_noise.driven_by(level, equations.dynamics.forces)
        for record_noise, level, equations in zip(noise.records, levels, by_record, strict=True)
    )
    return converged(evidence.train(replace(noise, records=tuple(driven)), inference.trained.solution.point))
