"""Load cells whose noise is a force that the model lacks: the same solution with a discrepancy in its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.force_spectrum import quietest_of_load_cells


def quiet_load_cells(inference: Inference) -> Inference | None:
    """With load cells as quiet as in the quietest part of their band; None: their noise is white, or known already.

    What they were found to have beyond that goes to the discrepancy, from which all levels are looked for again.
    """
    evidence, trained = inference.evidence, inference.trained
    if inference.is_informed or inference.problem.has_unknown_forces:
        return None
    limits, levels = evidence.each_record(_limits, trained), []
    if not any(np.isfinite(most).any() for most in limits):
        return None
    for noise, most in zip(trained.noise.records, limits, strict=True):
        loud = noise.force > most
        discrepancy = float(np.max(noise.force[loud], initial=0.0)) * noise.points_per_sample**0.5
        quiet = replace(noise, force=np.where(loud, most, noise.force))
        levels.append(replace(quiet, discrepancy=max(noise.discrepancy, discrepancy)))
    again = evidence.train(replace(trained.noise, records=tuple(levels)), trained.solution.point)
    if again is None or not again.solution.converged:
        return None
    return replace(inference, trained=inference.solver.settled(evidence, again))


def _limits(evidence: RecordEvidence, solution: RecordSolution) -> np.ndarray:
    """(functions,), how noisy load cells may be from now on; infinite where nothing new is known."""
    most = np.full(len(solution.noise.force), np.inf)
    for dof, level in quietest_of_load_cells(evidence, solution).items():
        evidence.load_cells[dof] = replace(evidence.load_cells[dof], quietest=level)
        most[dof] = evidence.load_cells[dof].loudest
    return most
