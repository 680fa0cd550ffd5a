"""How noisy every sensor is, and how large the force is that the model leaves out, as the record is most probable."""

from __future__ import annotations

import math

import numpy as np

from pinn_cli.baseline.iterated_smoother import IteratedSmoother, Pass
from pinn_cli.baseline.state_space import NoiseLevels, StateSpace
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.training.parameter_spread import updated_spread
from pinn_cli.training.steps.discrepancy_search import NEGLIGIBLE_GAIN

# The scan of the discrepancy goes down by decades, from the force that acts to this part of it.
DECADE, FINEST = 10.0, 1e-8
# A level needs its evidence, not its solution to the last digit: a step of this part of the motion changes neither.
ROUGH = 0.1
# Rounds of all levels at most; most records take three.
LEVEL_ROUNDS = 40
# Of the curvature, that is added to it at first; and how far a level's logarithm goes in one round.
FIRST_CURVATURE, FURTHEST = 0.1, math.log(10.0)


def stiffened(smoother: IteratedSmoother, levels: NoiseLevels, wanted: float) -> Pass:
    """The pass under a wanted discrepancy, N, reached by decades from that of ``levels``; sensors settle under it.

    Raises:
        FloatingPointError: A level could not be smoothed.
    """
    decades = max(1, math.ceil(abs(math.log(levels.discrepancy / wanted, DECADE))))
    reached = begun(smoother, levels)
    for discrepancy in np.geomspace(levels.discrepancy, wanted, decades + 1):
        reached = smoother.settle(reached.trajectory, levels.with_discrepancy(float(discrepancy)), ROUGH)
    return settled(smoother, reached, searched=np.arange(len(levels.values)) != len(levels.sensors))


def most_probable(smoother: IteratedSmoother, levels: NoiseLevels) -> Pass:
    """The pass under the levels of greatest evidence. Gains in doubt are held first, and found from what comes of it.

    Args:
        smoother: The problem's.
        levels: Where they start; the discrepancy is the force that acts.

    Raises:
        FloatingPointError: Not even the softest level could be smoothed.
    """
    smoother.hold({"gain"})
    best = scanned(smoother, begun(smoother, levels))
    if smoother.held.any():
        smoother.hold(())
        softer = best.levels.with_discrepancy(DECADE * best.levels.discrepancy)
        best = scanned(smoother, smoother.once(best.trajectory, softer))
    return settled(smoother, best)


def begun(smoother: IteratedSmoother, levels: NoiseLevels) -> Pass:
    """The motion from rest under prescribed parameters: what a structure at rest says of them is next to nothing."""
    held, smoother.held = smoother.held, smoother.uncertain
    first = smoother.once(smoother.space.start(), levels)
    smoother.held = held
    return first


def scanned(smoother: IteratedSmoother, begun: Pass) -> Pass:
    """The pass under the decade of greatest evidence, searched from soft physics to stiff.

    Every level starts at the last trajectory: soft physics forgives a start at rest, and each stiffer problem begins
    next to its solution.
    """
    best = smoother.settle(begun.trajectory, begun.levels, ROUGH)
    while best.levels.discrepancy > FINEST * begun.levels.discrepancy:
        stiffer = best.levels.with_discrepancy(best.levels.discrepancy / DECADE)
        try:
            tried = smoother.settle(best.trajectory, stiffer, ROUGH)
        except FloatingPointError:
            break  # stiffer than these numbers can follow
        gain = tried.log_evidence - best.log_evidence
        best = tried if gain > 0.0 else best
        if gain < NEGLIGIBLE_GAIN:
            break
    return best


def settled(smoother: IteratedSmoother, best: Pass, searched: np.ndarray | bool = True) -> Pass:
    """All noise levels where the record is most probable, one pass a round.

    Args:
        smoother: The problem's.
        best: Where to begin.
        searched: (m + L,) bool, which levels; the others are held.
    """
    damping, searched = FIRST_CURVATURE, np.flatnonzero(searched & ~smoother.space.held)
    slope, curvature = asked(smoother, best)
    for _ in range(LEVEL_ROUNDS):
        damped, step = curvature + damping * np.diag(np.diag(curvature).clip(min=1.0)), np.zeros(len(slope))
        step[searched] = np.linalg.solve(damped[np.ix_(searched, searched)], slope[searched])
        promised = 0.5 * float(slope @ step)
        if promised < NEGLIGIBLE_GAIN and damping <= FIRST_CURVATURE:
            break
        values = best.levels.values * np.exp(np.clip(step, -FURTHEST, FURTHEST))
        levels = best.levels.moved(np.maximum(values, smoother.space.finest), spread(smoother, best))
        again = smoother.once(best.trajectory, levels)
        gain = log_evidence(smoother.space, again) - log_evidence(smoother.space, best)
        damping *= 10.0 if gain < 0.0 else 0.1 if gain > 0.5 * promised else 1.0
        if gain > -NEGLIGIBLE_GAIN:
            best = again
            slope, curvature = asked(smoother, best)
    return best


def log_evidence(space: StateSpace, last: Pass) -> float:
    """That of the record and of what spectra show besides, of as many values as there are samples."""
    mask, levels = space.shown > 0.0, last.levels.values
    misfit = np.log(levels[mask] ** 2) + space.shown[mask] ** 2 / levels[mask] ** 2
    return float(last.log_evidence - 0.5 * len(space.present) * np.sum(misfit))


def asked(smoother: IteratedSmoother, last: Pass) -> tuple[np.ndarray, np.ndarray]:
    """Of the logarithms of all levels: the slope of the log evidence (m + L,), and its curvature.

    variance <- squares of the noise found / (values - those that motion and parameters have taken up) is where each by
    itself would be most probable (MacKay 1992); the curvature says how they go together. Spectra tell of some sensors'
    noise as well, as much as their samples, see :attr:`StateSpace.shown`.
    """
    space, regression = smoother.space, last.regression
    m = len(space.sensors)
    noise, information = last.filtered.information_on_noise(regression.change, regression.covariance)
    information[:, :m] *= space.present
    by_level, variance = space.noise_of_levels, last.levels.values**2
    shown, of_spectrum = space.shown, len(space.present) * (space.shown > 0.0)
    squares = variance**2 * (np.sum(noise**2, axis=0) @ by_level) + of_spectrum * shown**2
    values = variance * (np.sum(information, axis=0) @ by_level) + of_spectrum
    ratio = squares / (values * variance)
    scale = variance / np.sqrt(ratio)
    curvature = (
        2.0 * np.outer(scale, scale) * last.filtered.products(noise[:, :, None] * by_level, regression.covariance)
    )
    return values * np.log(ratio), curvature + np.diag(2.0 * of_spectrum)


def spread(smoother: IteratedSmoother, last: Pass) -> float:
    """How far believed parameters are off, in common."""
    if not (smoother.learn_spread and smoother.sharing.any()):
        return last.levels.spread
    regression, sharing, size = last.regression, smoother.sharing, last.levels.spread
    inverse = np.linalg.inv(regression.covariance)
    pull, precision = inverse @ smoother.space.coefficients(last.trajectory), regression.precision
    for _ in range(LEVEL_ROUNDS):
        sharpened = np.where(sharing, size**-2.0, precision)
        covariance = np.linalg.inv(inverse + np.diag(sharpened - precision))
        size = updated_spread((covariance @ pull)[sharing], np.diag(covariance)[sharing], size)
    return size


def widened(smoother: IteratedSmoother, best: Pass) -> Pass:
    """The discrepancy that its own colour asks for.

    The search takes it for white, N independent values in each equation. A model error fills only part of the sampled
    band, the sensors' usual oversampling, so it has fewer and larger ones: left at its white level, it would be trusted
    to be small where it is not, parameters would bend to it and bands would come out too narrow. The part is that of
    `pinn_cli.record.spectrum.occupied_band`, of the forces found where nothing else is in the equation.
    """
    sources, record = smoother.space.sources, smoother.space.problem.record
    of_model = sources[:, 0] > 0.0
    alone = of_model & ~sources[:, 1:].any(axis=1)
    residual = best.disturbances[:, alone if alone.any() else of_model]
    share = occupied_band(residual, record.step, record.sampling_rate / 2.0)
    wider = best.levels.with_discrepancy(best.levels.discrepancy / float(np.sqrt(share)))
    return smoother.settle(best.trajectory, wider, ROUGH)
