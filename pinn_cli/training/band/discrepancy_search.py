"""The search for the model error that makes a record, or several together, most probable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.band.evidence import Evidence, Trained
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.record_evidence import occupied_share
from pinn_cli.training.noise_model import NoiseLevels

# The scan over the discrepancy goes down by this factor: half a decade, fine enough for a parabola through three
# points.
SCAN_FACTOR = 10.0**0.5
# Where the evidence rises by more than this from one solution to the next, the peak is far: then steps are twice as
# long, while they take no more than so many factorisations.
FAR_FROM_THE_PEAK, EASILY_FOLLOWED = 200.0, 3
# A drop of the log evidence by this much ends the scan: the odds against anything stiffer are e^-20.
DECISIVE_DROP = 20.0
# The scan also ends after this many steps without a gain, or at this fraction of the force that it began with.
PATIENCE, FINEST_DISCREPANCY = 3, 1e-8
# A discrepancy below this part of the noise of every measured input makes no motion better known: one step without a
# gain ends the scan there.
FINEST_OF_NOISE = 1e-2
# A model error above this part of the force is either a model that is far off or a search that went astray: it is worth
# a second search from another start.
SUSPICIOUS_DISCREPANCY = 0.01
# Parabolas at most, and the gain in log evidence below which another is not worth a solution.
REFINEMENTS, NEGLIGIBLE_GAIN = 4, 0.5
# Relative change of the spread below which it is settled (a few parameters tell it to some tens of percent), and rounds
# at most.
SPREAD_TOLERANCE, SPREAD_ROUNDS = 0.05, 4


def searched(
    evidence: Evidence,
    noise: NoiseLevels,
    force: float,
    second_start: Callable[[], Point | None],
    refined: bool = True,
) -> Trained:
    """Most probable discrepancy and spread, from rest and, where that finds no good model, from another start.

    Where a structure is strongly nonlinear, the motion that soft physics finds may lie in the wrong valley.

    Args:
        evidence: Of the problem.
        noise: Sensor noise; its discrepancy is ignored.
        force: That acts, N.
        second_start: Another motion to begin with; None: there is none.
        refined: Whether to close in on the peak; not where all levels settle together afterwards.

    Raises:
        DivergenceError: Even the softest physics cannot be solved.
    """
    found = scanned(evidence, noise, force, evidence.equations.start(), refined)
    if found.solution.converged and found.noise.discrepancy < SUSPICIOUS_DISCREPANCY * force:
        return found
    start = second_start()
    if start is None:
        return found
    try:
        other = scanned(evidence, noise, SUSPICIOUS_DISCREPANCY * force, start, refined)
    except DivergenceError:
        return found
    return max(found, other, key=lambda trained: trained.log_evidence)


def scanned(evidence: Evidence, noise: NoiseLevels, largest: float, start: Point, refined: bool = True) -> Trained:
    """Most probable discrepancy and spread of the parameters, searched from soft physics to stiff.

    Every solution starts at the last. Soft physics is nearly linear and forgives a start at rest; each stiffer
    problem begins next to its solution. So the search for the noise level is also the continuation that long and
    stiff records need.

    Args:
        evidence: Of the problem.
        noise: Sensor noise; its discrepancy is ignored.
        largest: Where to begin, N: with a start at rest the force that acts.
        start: The motion to begin with.
        refined: See :func:`searched`.

    Raises:
        DivergenceError: The first problem cannot be solved.
    """
    tried: list[tuple[float, float]] = []  # of each the discrepancy and the log evidence: factors are large
    point, discrepancy, idle, stride = start, largest, 0, SCAN_FACTOR
    best: Trained | None = None
    indifferent = FINEST_OF_NOISE * noise.least_of_inputs
    while discrepancy > FINEST_DISCREPANCY * largest and idle < PATIENCE:
        trained = evidence.train(noise.with_discrepancy(discrepancy), point)
        followed = best is not None and best.solution.converged
        failed = trained is None or (followed and not trained.solution.converged)
        lower = trained is not None and best is not None and trained.log_evidence < best.log_evidence
        if stride > SCAN_FACTOR and (failed or lower):  # beyond what can be followed, or beyond the peak
            discrepancy, stride = discrepancy * stride / SCAN_FACTOR, SCAN_FACTOR
            continue
        if trained is None or failed:
            break  # stiffer than these steps or these numbers can follow
        stride = SCAN_FACTOR**2 if best is not None and _is_easy(best, trained) else SCAN_FACTOR
        tried.append((trained.noise.discrepancy, trained.log_evidence))
        point, noise = trained.solution.point, replace(noise, spread=evidence.learned_spread(trained))
        idle = 0 if best is None or trained.log_evidence > best.log_evidence else idle + 1
        best = trained if best is None or idle == 0 else best
        if trained.log_evidence < best.log_evidence - DECISIVE_DROP or (idle and discrepancy < indifferent):
            break
        discrepancy /= stride
        del trained  # before the next is made
    if best is None:
        raise DivergenceError(
            "the softest physics already has a singular normal matrix; use fewer knots or more sensors"
        )
    return _with_settled_spread(evidence, _refined(evidence, tried, best)) if refined else best


def _refined(evidence: Evidence, tried: list[tuple[float, float]], best: Trained) -> Trained:
    """Close in on the most probable discrepancy by parabolas through the best and its neighbours."""
    for _ in range(REFINEMENTS):
        tried.sort()
        middle = tried.index((best.noise.discrepancy, best.log_evidence))
        if not 0 < middle < len(tried) - 1:
            break
        top = _parabola_top(tried[middle - 1 : middle + 2])
        if top is None or top[1] - best.log_evidence < NEGLIGIBLE_GAIN:
            break
        trained = evidence.train(best.noise.with_discrepancy(top[0]), best.solution.point)
        if trained is None or not trained.solution.converged:
            break
        tried.append((trained.noise.discrepancy, trained.log_evidence))
        best = max(best, trained, key=lambda candidate: candidate.log_evidence)
    return best


def widened_for_colour(evidence: Evidence, trained: Trained) -> Trained:
    """Solve once more with the discrepancy that its own colour asks for.

    The search takes the discrepancy for K independent values per DOF. A model error that fills only part of the
    features' band has fewer, N_eff, and larger ones; counting K of them makes states look better known than they
    are. N_eff / K is the bandwidth of the physics residual, (sum S)^2 / (M sum S^2), over the M frequencies that
    the features follow.
    """
    levels = zip(trained.noise.records, evidence.each_record(occupied_share, trained), strict=True)
    widened = tuple(level.widened(share) for level, share in levels)
    wider = evidence.train(replace(trained.noise, records=widened), trained.solution.point)
    return wider if wider is not None and wider.solution.converged else trained


def _with_settled_spread(evidence: Evidence, trained: Trained) -> Trained:
    """Alternate spread and solution under one discrepancy until the spread stays."""
    for _ in range(SPREAD_ROUNDS):
        spread = evidence.learned_spread(trained)
        if abs(spread / trained.noise.spread - 1.0) < SPREAD_TOLERANCE:
            break
        again = evidence.train(replace(trained.noise, spread=spread), trained.solution.point)
        if again is None or not again.solution.converged:
            break
        trained = again
    return trained


def _is_easy(before: Trained, after: Trained | None) -> bool:
    """Whether a scan that goes on like that is still far from the peak, and may take longer steps to it."""
    if after is None or not (before.solution.converged and after.solution.converged):
        return False
    rise = after.log_evidence - before.log_evidence
    return rise > FAR_FROM_THE_PEAK and after.solution.factorisations <= EASILY_FOLLOWED and not after.solution.cautious


def _parabola_top(three: list[tuple[float, float]]) -> tuple[float, float] | None:
    """Discrepancy and log evidence at the top of the parabola through three of them; None where it opens upwards."""
    x = np.log([discrepancy for discrepancy, _ in three])
    curvature, slope, level = np.polyfit(x - x[1], [log_evidence for _, log_evidence in three], 2)
    if curvature >= 0:
        return None
    # A lopsided peak throws the parabola onto a neighbour: stay inside.
    offset = np.clip(-0.5 * slope / curvature, 0.9 * (x[0] - x[1]), 0.9 * (x[2] - x[1]))
    return float(np.exp(x[1] + offset)), float(level + offset * (slope + curvature * offset))
