"""The most probable parameters with the motion integrated out, from the most probable parameters and motion together.

The two differ where the equations leave the motion open. With H the Hessian by the readout weights and P that of the
equations alone, the density of the parameters has a factor (det P / det H)^(1/2) beside that of the one motion which
is most probable. In stiff physics it is a constant. Under a large discrepancy it is not: the motion follows its
sensors, errors of its accelerations make a regression on them too flat, and an unknown mass comes out too small. The
slope of that factor pulls at the parameters, as a constant force that is worked out anew where they have moved.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.system.quantities import OUTSIDE_THE_EQUATIONS
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.reported.model_evidence import of_motion
from pinn_cli.training.solver import Inference

# The pull, in standard deviations that it moves a parameter, that is not worth a round.
NEGLIGIBLE_PULL = 0.1
# Most that it changes in one round, in the same unit: it is told by a step of a part of a deviation.
LARGEST_MOVE, TOLD_BY = 2.0, 0.1


def move_to_marginal_peak(found: Inference) -> Inference | None:
    """The solution with the most probable parameters, the motion integrated out; None where it has them."""
    if found.is_informed:
        return None
    evidence, trained = found.evidence, found.trained
    held, pulls, moved = zip(*evidence.each_record(pull_on, trained), strict=True)
    if max(moved) < NEGLIGIBLE_PULL:
        return None
    evidence.each_record(pulled, trained, pulls)
    again = evidence.train(trained.noise, trained.solution.point)
    if again is None or not again.solution.converged or again.log_evidence < trained.log_evidence:
        evidence.each_record(pulled, trained, held)
        return None
    return replace(found, trained=again)


def pull_on(evidence: RecordEvidence, solution: RecordSolution) -> tuple[np.ndarray | None, np.ndarray, float]:
    """What pulls, (p,) slope of the logarithm of that factor by each parameter, and how far the change moves any.

    By a small step of each unknown parameter of the equations; 0 of the others. In prior standard deviations, the
    change in the parameter's own.
    """
    equations, point, noise = evidence.equations, solution.point, solution.noise
    std = np.sqrt(np.diag(solution.factor.corner_covariance))[: len(equations.uncertain)]
    before = np.zeros(len(std)) if equations.pull is None else equations.pull
    alone = of_motion(evidence, noise)

    def factor(shift: np.ndarray) -> float:
        moved = replace(point, parameters=point.parameters + point.parameters.new_tensor(shift))
        of_equations, of_all = (equations.assemble(moved, own).readout_log_determinant() for own in (alone, noise))
        return 0.5 * (of_equations - of_all)

    wanted = [p.unknown and p.kind not in OUTSIDE_THE_EQUATIONS for p in equations.uncertain]
    here, pull = factor(np.zeros(len(std))) if any(wanted) else np.nan, np.zeros(len(std))
    for i in np.flatnonzero(wanted) if np.isfinite(here) else ():
        # A discrepancy in a part of the band has as much fewer values: it was widened for these.
        slope = noise.occupied * (factor(TOLD_BY * std * (np.arange(len(std)) == i)) - here) / (TOLD_BY * std[i])
        pull[i] = np.clip(slope, before[i] - LARGEST_MOVE / std[i], before[i] + LARGEST_MOVE / std[i])
    pull = np.where(np.isfinite(pull), pull, 0.0)
    # The record may be computed in another process, which alone knows what pulls at it.
    return equations.pull, pull, float(np.max(np.abs(pull - before) * std, initial=0.0))


def pulled(evidence: RecordEvidence, solution: RecordSolution, pull: np.ndarray | None) -> None:
    """Let it pull at the parameters of one record from now on; None: nothing does."""
    evidence.equations.pull = pull
