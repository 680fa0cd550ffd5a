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
    quietest = evidence.each_record(quietest_of_load_cells, trained)
    if not any(quietest):
        return None
    levels = []
    for noise, most in zip(trained.noise.records, evidence.each_record(_limit, trained, quietest), strict=True):
        loud = noise.force > most
        discrepancy = float(np.max(noise.force[loud], initial=0.0)) * noise.points_per_sample**0.5
        quiet = replace(noise, force=np.where(loud, most, noise.force))
        levels.append(replace(quiet, discrepancy=max(noise.discrepancy, discrepancy)))
    again = evidence.train(replace(trained.noise, records=tuple(levels)), trained.solution.point)
    if again is None or not again.solution.converged:
        return None
    return replace(inference, trained=inference.solver.settled(evidence, again))


def _limit(evidence: RecordEvidence, solution: RecordSolution, quietest: dict[int, float]) -> np.ndarray:
    """Let no load cell be noisier from now on; (functions,) how noisy each may be."""
    most = np.full(len(solution.noise.force), np.inf)
    for dof, level in quietest.items():
        evidence.load_cells[dof] = replace(evidence.load_cells[dof], quietest=level)
        most[dof] = evidence.load_cells[dof].loudest
    return most
