"""Other solutions: structures that do the same at the sensors, and how probable the record makes each.

One search ends at one of them, whichever lies on its way, and standard deviations say nothing of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.record.channels import channels, record_band
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.frequency_response import Acting, Seen, rivals_of
from pinn_cli.system.parameters import LINEAR_UNITS, MASS, Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS, FORCE
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Rival
from pinn_cli.training.evidence import converged
from pinn_cli.training.minimise import Point
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.updated_problem import problem_in_own_modes

# Solutions that are weighed at most.
MOST_WEIGHED = 3
# Two solutions are one where no parameter differs by so many standard deviations, or by this part of its value.
RIVALS_APART, RIVALS_LEAST_APART = 4.0, 0.05
# As a logarithm: one that is less probable than the best by more is none.
AS_GOOD = 6.0
# Part of the record's band below which it shows no modes.
LOWEST = 0.01


def choose_equivalent_structure(inference: Inference) -> Inference | None:
    """The solution that lies nearest to the start among those that are as probable as any; None: there is one alone."""
    if inference.is_informed:
        return None
    solutions = [inference]
    for values in _rival_values(inference):
        rival = _solved(inference, values)
        if rival is not None and all(_differ(rival, solution) for solution in solutions):
            solutions.append(rival)
    if len(solutions) == 1:
        return None
    best = max(solution.trained.log_evidence for solution in solutions)
    as_good = [solution for solution in solutions if solution.trained.log_evidence > best - AS_GOOD]
    as_good.sort(key=_distance)
    first, *others = as_good
    rivals = []
    for other in others:
        unknown = {p: x for p, x in _values(other).items() if p.unknown and p.kind not in CALIBRATION_UNITS}
        log_odds = other.trained.log_evidence - first.trained.log_evidence
        rivals.append(Rival({p.name: x for p, x in unknown.items()}, log_odds))
    trained = first.trained if first is inference else first.solver.settled(first.evidence, first.trained)
    return replace(first, trained=trained, rivals=tuple(rivals))


def _rival_values(inference: Inference) -> list[dict[Parameter, float]]:
    """Values of the unknown parameters of structures that do the same."""
    problem, values = inference.problem, _values(inference)
    unknown = [p for p in values if p.unknown and p.kind in (MASS, "k")]
    if not unknown or problem.structure.is_modal:
        return []
    structure = problem.structure.with_values({p: x for p, x in values.items() if p.kind not in CALIBRATION_UNITS})
    seen = seen_by(structure, [record_problem.record for record_problem in problem])
    if not seen.acting.pushed.size and not problem.first.inputs.unmeasured:
        first, point = inference.by_record[0]
        motion = first.flat_states(first.observation, point)
        seen = replace(seen, released=np.stack([x[0, : first.dynamics.ndof].numpy() for x in motion[:2]]))
    rivals = rivals_of(structure, unknown, seen, MOST_WEIGHED)
    dampers = [p for p in values if p.unknown and p.kind == "c"]
    for rival in rivals:  # unknown dampers with the loss factors that their springs had
        springs = {p.index: x / values[p] for p, x in rival.items() if p.kind == "k"}
        rival.update({p: values[p] * springs[p.index] for p in dampers if p.index in springs})
    return rivals


def seen_by(structure: Structure, records: Sequence[Record]) -> Seen:
    """What sensors see of a structure and what acts on it, in all records together."""
    by_supports = structure.stretch.matrix[:, structure.coordinates :].toarray()
    nothing, still = np.zeros(structure.ndof), np.zeros(len(by_supports))
    sensing: list[np.ndarray] = []
    inputs: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for record in records:
        calibrated = [channel for channel in record.calibrated if not channel.is_column]
        for channel in (*channels(record, QUANTITIES), *calibrated):
            weights = np.zeros(structure.ndof)
            weights[list(channel.weights)] = list(channel.weights.values())
            if channel.quantity in RESPONSE_QUANTITIES:
                sensing.append(weights)
            elif channel.quantity == FORCE:
                inputs.append((weights, nothing, still))
        if record.measured_ground is not None:
            inputs.append((nothing, structure.with_ground, still))
        if record.supports:
            inputs += [(nothing, nothing, stretching) for stretching in by_supports.T]
    high = max(map(record_band, records))
    low = max(LOWEST * high, 1.0 / max(record.duration for record in records))
    return Seen(np.reshape(sensing, (-1, structure.ndof)), Acting.of(inputs, structure.ndof), low, high)


def _solved(inference: Inference, values: dict[Parameter, float]) -> Inference | None:
    """The solution next to these values, under the same noise and damped in its own modes; None where there is none."""
    equations, point = inference.evidence.equations, inference.trained.solution.point
    moved = point.parameters.clone()
    for i, p in enumerate(equations.uncertain):
        if p in values:
            moved[i] = (values[p] - p.prescribed) / equations.scale[i]
    moved_point = Point(point.unknowns, moved)
    solution = replace(inference.trained.solution, point=moved_point)
    begun = replace(inference, trained=replace(inference.trained, solution=solution))
    problem = problem_in_own_modes(begun)
    if problem is not None:
        begun = replace(begun, evidence=inference.solver.evidence(problem))
        begun.evidence.equations.share_ridges(equations)
    try:
        followed = begun.evidence.equations.followed(moved_point, inference.trained.noise)
        again = converged(begun.evidence.train(inference.trained.noise, followed))
    except DivergenceError:
        return None
    return None if again is None else replace(begun, trained=again)


def _values(inference: Inference) -> dict[Parameter, float]:
    equations = inference.evidence.equations
    scaled = inference.trained.solution.point.parameters.numpy() * equations.scale
    return {p: p.value(float(x)) for p, x in zip(equations.uncertain, scaled, strict=True)}


def _differ(a: Inference, b: Inference) -> bool:
    """Whether two solutions are not one."""
    equations = a.evidence.equations
    values_a, values_b = (np.array(list(_values(inference).values())) for inference in (a, b))
    spread = sum(np.diag(inference.trained.factor.corner_covariance) for inference in (a, b)) ** 0.5
    distance = np.abs(values_a - values_b)
    relevant = np.array([p.unknown and p.kind in LINEAR_UNITS for p in equations.uncertain])
    apart = np.maximum(RIVALS_APART * spread * equations.scale, RIVALS_LEAST_APART * np.abs(values_a))
    return bool((relevant & (distance > apart)).any())


def _distance(inference: Inference) -> float:
    """Of the unknown masses and springs from what the user says, else from where they started, as logarithms."""
    springs = {p: x for p, x in _values(inference).items() if p.unknown and p.kind in (MASS, "k")}
    pairs = [(x, p.said if p.said > 0 else p.prescribed) for p, x in springs.items()]
    return sum(math.log(x / start) ** 2 for x, start in pairs if x > 0 and start > 0)
