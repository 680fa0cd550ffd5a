"""Other solutions: structures that do the same at the sensors, and how probable the record makes each.

One search ends at one of them, whichever lies on its way, and standard deviations say nothing of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.frequency_response import Acting, Seen, twins
from pinn_cli.system.parameters import LINEAR_UNITS, MASS, Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS, FORCE
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Rival
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.point import Point
from pinn_cli.training.solver import Inference

# Solutions that are weighed at most.
MOST_WEIGHED = 3
# Two solutions are one where no parameter differs by so many standard deviations, or by this part of its value.
RIVALS_APART, RIVALS_LEAST_APART = 4.0, 0.05
# As a logarithm: one that is less probable than the best by more is none.
AS_GOOD = 6.0
# Part of the record's band below which it shows no modes.
LOWEST = 0.01


def choose_equivalent_structure(found: Inference) -> Inference | None:
    """The solution that lies nearest to the start among those that are as probable as any; None: there is one alone."""
    if found.is_informed:
        return None
    evidence, trained = found.evidence, found.trained
    solutions = [trained]
    for values in _others(evidence, trained):
        other = _solved(evidence, trained, values)
        if other is not None and all(_differ(evidence, other, one) for one in solutions):
            solutions.append(other)
    if len(solutions) == 1:
        return None
    best = max(one.log_evidence for one in solutions)
    as_good = [one for one in solutions if one.log_evidence > best - AS_GOOD]
    as_good.sort(key=lambda one: _distance(evidence, one))
    first = as_good[0] if as_good[0] is trained else found.solver.settled(evidence, as_good[0])
    rivals = [_rival(evidence, one, one.log_evidence - as_good[0].log_evidence) for one in as_good[1:]]
    return replace(found, trained=first, rivals=tuple(rivals))


def _others(evidence: Evidence, trained: Trained) -> list[dict[Parameter, float]]:
    """Values of the unknown parameters of structures that do the same."""
    problem, values = evidence.problem, _values(evidence, trained)
    unknown = [p for p in values if p.unknown and p.kind in (MASS, "k")]
    if not unknown or problem.structure.is_modal:
        return []
    structure = problem.structure.with_values({p: x for p, x in values.items() if p.kind not in CALIBRATION_UNITS})
    found = twins(structure, unknown, seen_by(structure, [own.record for own in problem]), MOST_WEIGHED)
    return [other | _dampers(values, other) for other in found]


def _dampers(values: dict[Parameter, float], other: dict[Parameter, float]) -> dict[Parameter, float]:
    """Unknown dampers with the loss factors that their springs had."""
    springs = {p.index: x / values[p] for p, x in other.items() if p.kind == "k"}
    return {p: x * springs[p.index] for p, x in values.items() if p.kind == "c" and p.unknown and p.index in springs}


def seen_by(structure: Structure, records: Sequence[Record]) -> Seen:
    """What sensors see of a structure and what acts on it, in all records together."""
    one, by_supports = np.eye(structure.ndof), structure.stretch.matrix[:, structure.coordinates :].toarray()
    nothing, still = np.zeros(structure.ndof), np.zeros(len(by_supports))
    sensing: list[np.ndarray] = []
    inputs: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for record in records:
        sensing += [one[dof] for q in RESPONSE_QUANTITIES for dof in np.flatnonzero(record.sensors(q))]
        inputs += [(one[dof], nothing, still) for dof in np.flatnonzero(record.sensors(FORCE))]
        for gauge in (gauge for gauge in record.gauges if gauge.dof is None):  # one of a single DOF has a column, too
            weights = np.zeros(structure.ndof)
            weights[list(gauge.weights)] = list(gauge.weights.values())
            if gauge.quantity in RESPONSE_QUANTITIES:
                sensing.append(weights)
            elif gauge.quantity == FORCE:
                inputs.append((weights, nothing, still))
        if record.ground_acceleration is not None:
            inputs.append((nothing, structure.with_ground, still))
        if record.supports:
            inputs += [(nothing, nothing, stretching) for stretching in by_supports.T]
    high = max(map(record_band, records))
    low = max(LOWEST * high, 1.0 / max(record.duration for record in records))
    return Seen(np.reshape(sensing, (-1, structure.ndof)), Acting.of(inputs, structure.ndof), low, high)


def _solved(evidence: Evidence, trained: Trained, values: dict[Parameter, float]) -> Trained | None:
    """The solution next to these values, under the same noise; None where there is none."""
    equations, point = evidence.equations, trained.solution.point
    scale, moved = equations.scale, point.parameters.clone()
    for i, p in enumerate(equations.uncertain):
        if p in values:
            moved[i] = (values[p] - p.prescribed) / scale[i]
    try:
        again = evidence.train(trained.noise, equations.followed(Point(point.unknowns, moved), trained.noise))
    except DivergenceError:
        return None
    return again if again is not None and again.solution.converged else None


def _values(evidence: Evidence, trained: Trained) -> dict[Parameter, float]:
    scaled = trained.solution.point.parameters.cpu().numpy() * evidence.equations.scale
    return {p: p.value(float(x)) for p, x in zip(evidence.equations.uncertain, scaled, strict=True)}


def _differ(evidence: Evidence, a: Trained, b: Trained) -> bool:
    """Whether two solutions are not one."""
    mine, theirs = (np.array(list(_values(evidence, one).values())) for one in (a, b))
    spread = sum(np.diag(one.factor.corner_covariance) for one in (a, b)) ** 0.5
    scale, apart = evidence.equations.scale, np.abs(mine - theirs)
    relevant = np.array([p.unknown and p.kind in LINEAR_UNITS for p in evidence.equations.uncertain])
    return bool(
        ((apart > RIVALS_APART * spread * scale) & (apart > RIVALS_LEAST_APART * np.abs(mine)) & relevant).any()
    )


def _distance(evidence: Evidence, trained: Trained) -> float:
    """Of the unknown masses and springs from what the user says, else from where they started, as logarithms."""
    springs = {p: x for p, x in _values(evidence, trained).items() if p.unknown and p.kind in (MASS, "k")}
    pairs = [(x, p.said if p.said > 0 else p.prescribed) for p, x in springs.items()]
    return sum(math.log(x / start) ** 2 for x, start in pairs if x > 0 and start > 0)


def _rival(evidence: Evidence, trained: Trained, log_odds: float) -> Rival:
    values = {p.name: x for p, x in _values(evidence, trained).items() if p.unknown and p.kind not in CALIBRATION_UNITS}
    return Rival(values, log_odds)
