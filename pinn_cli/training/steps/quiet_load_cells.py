"""Load cells whose noise is a force that the model lacks: the same solution with a discrepancy in its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.training.evidence import converged
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.force_spectrum import (
    FEWEST_OF_PART,
    PARTS,
    all_driven,
    drive_below,
    parts_of,
    sums_by_part,
)

# Share of a part's values that the record must determine for its level to be told; and logarithm of how many times as
# probable levels of their own make a load cell's noise that is not white.
TOLD_OF_PART, COLOURED_CELL = 0.25, 50.0


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
    again = converged(evidence.train(replace(trained.noise, records=tuple(levels)), trained.solution.point))
    return None if again is None else replace(inference, trained=inference.solver.settled(evidence, again))


def _limits(evidence: RecordEvidence, solution: RecordSolution) -> np.ndarray:
    """(functions,), how noisy load cells may be from now on; infinite where nothing new is known.

    That is as noisy as in the quietest part of their band, where their noise is far from white. What the model lacks is
    largest where the structure moves most, and passes for it where no spectrum shows how little it is.
    """
    most, as_driven = np.full(len(solution.noise.force), np.inf), all_driven(solution)
    for dof in [dof for dof, cell in evidence.load_cells.items() if not cell.shown]:
        seen = drive_below(evidence, as_driven, slice(dof, dof + 1), 0.5 / evidence.problem.record.step)
        if seen is None:
            continue
        part = parts_of(seen.frequency)
        power, values = (sums_by_part(part, x)[:, 0] for x in (seen.power, seen.determined))
        count = np.bincount(part, minlength=PARTS)
        told = (values > TOLD_OF_PART * count) & (count > FEWEST_OF_PART)
        level = power[told] / values[told]
        if told.any() and float(values[told] @ np.log(power[told].sum() / values[told].sum() / level)) > COLOURED_CELL:
            quietest = float(np.sqrt(level.min() / solution.noise.points_per_sample))
            evidence.load_cells[dof] = replace(evidence.load_cells[dof], quietest=quietest)
            most[dof] = evidence.load_cells[dof].loudest
    return most
