"""The discrepancy of a window, by what it and the windows before it say together.

A discrepancy that is small against the sensors' noise leaves a record as probable as none does, so that where a search
ends within that range is chance. What the model may hide of a parameter grows with it all the same. A long record says
that it is smaller than a window of it can, and the windows one after the other say what the long record says: each adds
its log evidence, a function of the discrepancy over the force that acts. Where none at all is as probable as the most
probable one, the least that is looked for is taken, as a search takes it that comes from above and finds nothing to
stop at.

A window that contradicts those before it, or that tells its discrepancy by itself, keeps its own.

The discrepancy as the few independent values that it has.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.model.knowledge import DiscrepancyEvidence
from pinn_cli.training.evidence import Evidence, Trained, converged
from pinn_cli.training.levels import floor
from pinn_cli.training.record_evidence import occupied_share
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.discrepancy_search import DECISIVE_DROP, NEGLIGIBLE_GAIN

# From one discrepancy that is tried to the next, decades.
STEP_DECADES = 0.25
# Steps upwards at most.
HIGHEST = 8
# Log evidence from the smallest discrepancy's below which smaller ones than that are all the same.
FLAT_EVIDENCE = 0.05
# Log evidence that a window's own discrepancy may have over that of all windows before it contradicts them.
CONTRADICTION = 3.0
# Relative decrease of the loss below which a solution under another discrepancy is near enough.
NEAR_LOSS = 1e-3


def combine_windows(inference: Inference) -> Inference | None:
    """The solution of a window under the discrepancy that all windows say; None of a record that is none."""
    first = inference.problem.first
    goes_on = first.earlier_levels is not None and first.earlier_levels.windows is not None
    is_window = first.hand_over is not None or goes_on
    if inference.solver.known_parameters is not None or inference.problem.has_unknown_forces or not is_window:
        return None
    trained, discrepancy = of_all_windows(inference.evidence, inference.trained)
    return replace(inference, trained=trained, discrepancy=discrepancy)


def of_all_windows(evidence: Evidence, trained: Trained) -> tuple[Trained, DiscrepancyEvidence]:
    """The solution under the discrepancy that all windows say, from that of a window, and what they say of it."""
    earlier_levels = evidence.problem.first.earlier_levels
    before = None if earlier_levels is None else earlier_levels.windows
    unit = discrepancy_unit(evidence)
    top = float(np.log10(trained.noise.discrepancy / unit))
    earlier = np.inf if before is None or not before.common else float(np.log10(before.start))
    (lowest,) = evidence.each_record(floor, trained)
    least = min(float(np.log10(lowest.discrepancy / unit)), earlier)
    own_evidence = _own_evidence(evidence, trained, unit, (least, top))
    places = _places(own_evidence, before)
    if own_evidence is None:
        return trained, DiscrepancyEvidence(10.0**top, False, places, _at(before, places))
    total = own_evidence.at(places) + _at(before, places)
    least = float(own_evidence.places[0])
    tried = np.sort(np.concatenate((places[places > least], [least, top])))
    sums = own_evidence.at(tried) + _at(before, tried)
    chosen = least if sums[0] >= sums.max() - NEGLIGIBLE_GAIN else float(tried[np.argmax(sums)])
    common = bool(own_evidence.at(np.array([chosen]))[0] >= -CONTRADICTION)
    solution = None
    if common and chosen != top:
        noise = trained.noise.with_discrepancy(unit * 10.0**chosen)
        solution = converged(evidence.train(noise, trained.solution.point))
    if solution is None:
        chosen, solution = top, trained
    factor = before.start / 10.0**chosen if before is not None and before.common and common else 1.0
    levels = solution.noise.each(lambda record_noise: replace(record_noise, earlier_misfit=factor))
    return replace(solution, noise=levels), DiscrepancyEvidence(10.0**chosen, common, places, total)


def discrepancy_unit(evidence: Evidence) -> float:
    """N, of a discrepancy that is the force that acts, in a sample of one second."""
    first = evidence.equations.by_record[0]
    force, _ = force_and_velocity_scale(first.problem)
    return float(force * (first.refinement / first.problem.record.step) ** 0.5)


def _own_evidence(
    evidence: Evidence, trained: Trained, unit: float, between: tuple[float, float]
) -> DiscrepancyEvidence | None:
    """What a window says by itself, over its own most probable one; None where even none at all is improbable."""
    least, top = between
    values = {top: 0.0}

    def tried(place: float) -> float:
        noise = trained.noise.with_discrepancy(unit * 10.0**place)
        again = evidence.train(noise, trained.solution.point, NEAR_LOSS, goes_on=True)
        stiff = again is None or not np.isfinite(again.log_evidence)
        return -np.inf if again is None or stiff else again.log_evidence - trained.log_evidence

    while least < top and not np.isfinite(value := tried(least)):  # stiffer than these numbers can follow
        least += 1.0
    if least < top:
        values[least] = value
        if value <= -DECISIVE_DROP:
            return None
    place = STEP_DECADES * np.floor(top / STEP_DECADES)
    while place > least and np.isfinite(value := 0.0 if place == top else tried(place)):
        values[place] = value
        if abs(value - values[least]) <= FLAT_EVIDENCE:
            break
        place -= STEP_DECADES
    place, highest = (STEP_DECADES * np.floor(top / STEP_DECADES + step) for step in (1.0, HIGHEST))
    while place <= highest and (value := tried(place)) > max(values.values()) - DECISIVE_DROP:
        values[place] = value
        place += STEP_DECADES
    values[place] = max(values.values()) - DECISIVE_DROP  # or less: as improbable
    places = sorted(values)
    return DiscrepancyEvidence(10.0**top, True, np.array(places), np.array([values[place] for place in places]))


def _places(*evidences: DiscrepancyEvidence | None) -> np.ndarray:
    """Whole steps over all that was tried."""
    tried = np.concatenate([np.zeros(0), *(evidence.places for evidence in evidences if evidence is not None)])
    if len(tried) == 0:
        return tried
    return STEP_DECADES * np.arange(np.floor(tried.min() / STEP_DECADES), np.ceil(tried.max() / STEP_DECADES) + 1)


def _at(windows: DiscrepancyEvidence | None, places: np.ndarray) -> np.ndarray:
    return np.zeros(len(places)) if windows is None else windows.at(places)


def count_independent_values(inference: Inference) -> Inference:
    """The solution with the discrepancy that its own colour asks for."""
    return replace(inference, trained=widened(inference.evidence, inference.trained))


def widened(evidence: Evidence, trained: Trained) -> Trained:
    """Solved once more with a wider discrepancy; the same where that cannot be solved.

    The search takes the discrepancy for K independent values per DOF. A model error that fills only part of the
    features' band has fewer, N_eff, and larger ones; counting K of them makes states look better known than they
    are. N_eff / K is the bandwidth of the physics residual, (sum S)^2 / (M sum S^2), over the M frequencies that
    the features follow.
    """
    levels = zip(trained.noise.records, evidence.each_record(occupied_share, trained), strict=True)
    noise = replace(trained.noise, records=tuple(level.widened(share) for level, share in levels))
    return converged(evidence.train(noise, trained.solution.point)) or trained
