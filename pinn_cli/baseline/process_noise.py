"""How large the force is that the model leaves out: the level under which the record is most probable."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from pinn_cli.baseline.iterated_smoother import IteratedSmoother, Pass
from pinn_cli.baseline.state_space import NoiseLevels
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.training.steps.discrepancy_search import NEGLIGIBLE_GAIN

# The scan goes down by decades, from the force that acts to this part of it.
DECADE, FINEST = 10.0, 1e-8
# Where the peak lies inside, a bounded search closes in on it to this many e-folds, in so many evaluations at most.
RESOLUTION, EVALUATIONS = 0.4, 4
# A level needs its evidence, not its solution to the last digit: a step of this part of the motion changes neither.
ROUGH = 0.1


def stiffened(smoother: IteratedSmoother, levels: NoiseLevels, wanted: float) -> Pass:
    """The pass under a wanted discrepancy, N, reached by decades from that of ``levels``.

    Raises:
        FloatingPointError: A level could not be smoothed.
    """
    decades = max(1, math.ceil(abs(math.log(levels.discrepancy / wanted, DECADE))))
    trajectory = smoother.space.start()
    for discrepancy in np.geomspace(levels.discrepancy, wanted, decades + 1):
        reached = smoother.settle(trajectory, replace(levels, discrepancy=float(discrepancy)), ROUGH)
        trajectory, levels = reached.trajectory, reached.levels
    return reached


def most_probable(smoother: IteratedSmoother, levels: NoiseLevels, begun: Pass | None = None) -> Pass:
    """The pass under the discrepancy of greatest evidence, searched from soft physics to stiff.

    Every level starts at the last trajectory, as in `pinn_cli.training.evidence`: soft physics forgives a start at
    rest, and each stiffer problem begins next to its solution.

    Args:
        smoother: The problem's.
        levels: Sensor noise, and the discrepancy to begin with: the force that acts.
        begun: Where to begin; None: at rest, with the prescribed parameters.

    Raises:
        FloatingPointError: Not even the softest level could be smoothed.
    """
    tried = [smoother.settle(smoother.space.start() if begun is None else begun.trajectory, levels, ROUGH)]
    while tried[-1].levels.discrepancy > FINEST * levels.discrepancy:
        last = tried[-1]
        stiffer = replace(last.levels, discrepancy=last.levels.discrepancy / DECADE)
        try:
            tried.append(smoother.settle(last.trajectory, stiffer, ROUGH))
        except FloatingPointError:
            break  # stiffer than these numbers can follow
        if tried[-1].regression.log_evidence < last.regression.log_evidence + NEGLIGIBLE_GAIN:
            break
    return _refined(smoother, tried)


def most_probable_with_gains(smoother: IteratedSmoother, levels: NoiseLevels) -> Pass:
    """The same where gains of sensors are in doubt: they are held first, and found from what comes of it.

    Raises:
        FloatingPointError: See :func:`most_probable`.
    """
    if not smoother.gains.any():
        return most_probable(smoother, levels)
    smoother.hold_gains(True)
    held = most_probable(smoother, levels)
    smoother.hold_gains(False)
    return most_probable(smoother, replace(held.levels, discrepancy=DECADE * held.levels.discrepancy), held)


def widened(smoother: IteratedSmoother, best: Pass) -> Pass:
    """The discrepancy that its own colour asks for.

    The search takes it for white, N independent values on each DOF. A model error fills only part of the sampled band,
    the sensors' usual oversampling, so it has fewer and larger ones: left at its white level, it would be trusted to be
    small where it is not, parameters would bend to it and bands would come out too narrow. The part is that of
    `pinn_cli.record.spectrum.occupied_band`, of the forces found where nothing is known to act.
    """
    record = smoother.space.problem.record
    of = record.unforced if record.unforced.any() else np.ones(record.ndof, dtype=bool)
    share = occupied_band(best.disturbances[:, of], record.step, record.sampling_rate / 2.0)
    wider = replace(best.levels, discrepancy=best.levels.discrepancy / float(np.sqrt(share)))
    return smoother.settle(best.trajectory, wider, ROUGH)


def _refined(smoother: IteratedSmoother, tried: list[Pass]) -> Pass:
    """Close in on the peak between the neighbours of the best level; a plateau needs no closing in."""
    best = max(tried, key=_evidence)
    place = tried.index(best)
    around = tried[max(place - 1, 0) : place + 2]
    if _evidence(best) - _evidence(tried[-1]) < NEGLIGIBLE_GAIN:
        return best

    def lack(log_discrepancy: float) -> float:
        nonlocal best
        level = replace(best.levels, discrepancy=float(np.exp(log_discrepancy)))
        try:
            found = smoother.settle(best.trajectory, level, ROUGH)
        except FloatingPointError:
            return np.inf
        best = max(best, found, key=_evidence)
        return -_evidence(found)

    bounds = [float(np.log(one.levels.discrepancy)) for one in (around[-1], around[0])]
    minimize_scalar(lack, bounds=bounds, method="bounded", options={"xatol": RESOLUTION, "maxiter": EVALUATIONS})
    return best


def _evidence(one: Pass) -> float:
    return one.regression.log_evidence
