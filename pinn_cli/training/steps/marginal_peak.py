"""The most probable parameters with the motion integrated out, from the most probable parameters and motion together.

The two differ where the equations leave the motion open. With H the Hessian by the readout weights and P that of the
equations alone, the density of the parameters has a factor (det P / det H)^(1/2) beside that of the one motion which
is most probable. In stiff physics it is a constant. Under a large discrepancy it is not: the motion follows its
sensors, errors of its accelerations make a regression on them too flat, and an unknown mass comes out too small. The
slope of that factor pulls at the parameters, as a constant force that is worked out anew where they have moved.

Under forces that nobody measured it is no small change, see :mod:`pinn_cli.training.steps.marginal_likelihood`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.system.quantities import OUTSIDE_THE_EQUATIONS
from pinn_cli.training.evidence import converged, left_by_motion, model_log_evidence
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.discrepancy_search import NEGLIGIBLE_GAIN
from pinn_cli.training.steps.marginal_likelihood import WIDTH_OF_DIFFERENCE, most_probable_parameters, pulled

# How far a round may move any parameter, in its standard deviations, and how far is not worth a round.
LARGEST_MOVE, NEGLIGIBLE_PULL = 2.0, 0.1
# Parts of a change of what pulls that are tried, one after the other, where a law bends within it.
PARTS_OF_PULL = (1.0, 0.25)
# Of a parameter that is known better differences reach as if it were known to this part of its value: beside rounding.
PART_OF_VALUE = 0.05


def move_to_marginal_peak(inference: Inference) -> Inference | None:
    """The solution with the most probable parameters, the motion integrated out; None where it has them."""
    if inference.is_informed or inference.at_marginal_peak or not inference.explains_something:
        return None
    if inference.problem.has_unknown_forces:
        return most_probable_parameters(inference)
    evidence, trained = inference.evidence, inference.trained
    held, pulls, moved = zip(*evidence.each_record(pull_on, trained), strict=True)
    if not np.isfinite(moved).all():
        return None
    if max(moved) < NEGLIGIBLE_PULL:
        return replace(inference, at_marginal_peak=True)
    for share in PARTS_OF_PULL:
        ends = zip(held, pulls, strict=True)
        between = [share * new + (0.0 if old is None else (1.0 - share) * old) for old, new in ends]
        evidence.each_record(pulled, trained, between)
        again = converged(evidence.train(trained.noise, trained.solution.point))
        if again is None:
            continue
        # Where an accelerometer is compared with the equations nothing says how probable that is: NaN.
        if not model_log_evidence(evidence, again) - model_log_evidence(evidence, trained) < -NEGLIGIBLE_GAIN:
            return replace(inference, trained=again)
        # Near the peak a move gains half of its square, of which less than that cannot be told.
        if 0.5 * max(moved) ** 2 < NEGLIGIBLE_GAIN:
            inference = replace(inference, at_marginal_peak=True)
            break
    evidence.each_record(pulled, trained, held)
    return inference if inference.at_marginal_peak else None


def pull_on(evidence: RecordEvidence, solution: RecordSolution) -> tuple[np.ndarray | None, np.ndarray, float]:
    """What pulled before, and what is to pull: (p,) slope of the logarithm of that factor, by prior deviations.

    Of each parameter of the equations that is looked for, the motion held; 0 of the others. Where the change would take
    a parameter too far, less of it: all of it together, for what parameters have in common pulls at each of them.

    Returns:
        Both, and how far all of the change moves any parameter, in its standard deviations; NaN where nothing tells.
    """
    equations, point, noise = evidence.equations, solution.point, solution.noise
    p = len(equations.uncertain)
    covariance = solution.factor.corner_covariance[:p, :p]
    std, pull = np.sqrt(np.diag(covariance)), np.zeros(p)
    before = np.zeros(p) if equations.pull is None else equations.pull
    values = np.array([p.prescribed for p in equations.uncertain]) / equations.scale.numpy() + point.parameters.numpy()
    wanted = [p.unknown and p.kind not in OUTSIDE_THE_EQUATIONS for p in equations.uncertain]
    for i in np.flatnonzero(wanted).tolist():
        width = WIDTH_OF_DIFFERENCE * max(std[i], PART_OF_VALUE * abs(values[i]))
        above, below = (left_by_motion(evidence, end, noise) for end in point.beside(i, width))
        # A discrepancy in a part of the band has as much fewer values: it was widened for these.
        pull[i] = noise.occupied * (above - below) / (2.0 * width)
    # The record may be computed in another process, which alone knows what pulls at it.
    change = pull - before
    move = float(np.max(np.abs(covariance @ change) / std, initial=0.0))
    change *= min(1.0, LARGEST_MOVE / max(move, NEGLIGIBLE_PULL))
    return equations.pull, before + change, move
