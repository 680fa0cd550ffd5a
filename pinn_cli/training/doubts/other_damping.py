"""Another model of damping than a problem's, beside the solution: a ratio for each mode, or dampers of the connections.

Its parameters begin at zero. The spectra under forces that nobody measured say what they would be, and by how much the
record would be more probable; what they cost is how far that narrows their priors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.channels import record_band
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import damped
from pinn_cli.system.damping import RATIO
from pinn_cli.system.modes import NaturalModes
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import OUTSIDE_THE_EQUATIONS

# Prior standard deviation of a damping ratio that nobody has thought of, and of a damper as a part of its critical one.
USUAL = 0.05
# Logarithm of how many times as probable a record must be with another model of damping: one of many doubts has to be
# more probable, this one is asked alone.
DECISIVE_DAMPING = 6.0
# A ratio for each mode couples all coordinates; beyond so many a look at it would take longer than the solution.
MOST_COORDINATES = 20


@dataclass(frozen=True, eq=False)
class DampingDoubt:
    """What a record says of another model of damping than that of the estimate.

    Attributes:
        log_odds: Natural logarithm of how many times as probable the record is with it.
        of_modes: Whether the other model is a ratio for each mode; else dampers of the connections beside such ratios.
        ratios: (modes in the record's band,), of the estimate.
        other_ratios: Likewise, of the other model.
    """

    log_odds: float
    of_modes: bool
    ratios: np.ndarray
    other_ratios: np.ndarray


def with_other_damping(problem: Problem, values: Mapping[str, np.ndarray]) -> Problem | None:
    """The problem with the damping that its model lacks, unknown and at zero; None where that is not asked.

    It is asked of a linear structure of masses and connections, with every parameter by kind at its solution.
    """
    structure = problem.structure
    plain = not structure.is_modal and structure.has_linear_laws and problem.prior is None
    if not plain or structure.coordinates > MOST_COORDINATES or problem.initial_state is not None:
        return None
    if RATIO in structure.parameters:
        new = [structure.parameter("c", i) for i in range(len(values["c"]))]
        critical = 2.0 * np.sqrt(np.abs(values["k"]) * np.mean(values[MASS]))
        added = [replace(p, prior_std=USUAL * float(size)) for p, size in zip(new, critical, strict=True) if size > 0]
    else:
        structure = damped(structure, {"ratio": [0.0] * structure.coordinates}).present(values)
        added = [replace(structure.parameter(RATIO, i), prior_std=USUAL) for i in range(structure.coordinates)]
    added = [replace(p, unknown=True) for p in added if p not in problem.uncertain]
    return replace(problem, structure=structure, uncertain=(*problem.uncertain, *added)) if added else None


def damping_doubt(
    problem: Problem, extended: Problem, distances: tuple[np.ndarray, np.ndarray], log_odds: float
) -> DampingDoubt | None:
    """What a step says of the damping ratios in the record's band; None where it leaves no structure.

    Args:
        problem: Without the other damping.
        extended: With it, see :func:`with_other_damping`.
        distances: Of its p uncertain parameters from where they are prescribed, in their own units, before and after.
        log_odds: Of the extended problem over the other, as a natural logarithm.
    """
    modes = []
    for distance in distances:
        moved = zip(extended.uncertain, distance.tolist(), strict=True)
        values = {p: p.prescribed + x for p, x in moved if p.kind not in OUTSIDE_THE_EQUATIONS}
        modes.append(NaturalModes.of(extended.structure.with_values(values)))
    own, other = modes
    if own is None or other is None or len(own.squares) != len(other.squares):
        return None
    seen = own.frequencies < record_band(extended.record)
    # A step may go beyond no damping at all.
    other_ratios = np.maximum(other.damping_ratios[own.partners(other)], 0.0)
    of_modes = RATIO not in problem.structure.parameters
    return DampingDoubt(log_odds, of_modes, own.damping_ratios[seen], other_ratios[seen])
