"""The iterated extended smoother: linearise about a trajectory, smooth, repeat, which is Gauss-Newton (Bell 1994).

Parameters and initial state are coefficients of a regression on the filtered series. How noisy every sensor is, and how
large the force is that the model leaves out, is searched for where the record is most probable.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pinn_cli.baseline.linear_gaussian import Filtered
from pinn_cli.baseline.state_space import Linearised, NoiseLevels, StateSpace, Trajectory
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.noise_model import updated_spread
from pinn_cli.training.steps.discrepancy_search import NEGLIGIBLE_GAIN

# Steps shorter than this part of the motion are taken unseen: the model is smooth on their scale, and looking costs a
# tenth of a pass. A longer one is halved until the misfit falls, so many times at most.
SHORT_STEP, HALVINGS = 0.1, 6
# Prior precision of a gain that is held: of a millionth of its prior standard deviation.
HELD_PRECISION = 1e12
# The scan of the discrepancy goes down by decades, from the force that acts to this part of it.
DECADE, FINEST = 10.0, 1e-8
# A level needs its evidence, not its solution to the last digit: a step of this part of the motion changes neither.
ROUGH = 0.1
# Rounds of all levels at most; most records take three.
LEVEL_ROUNDS = 40
# Of the curvature, that is added to it at first; and how far a level's logarithm goes in one round.
FIRST_CURVATURE, FURTHEST = 0.1, math.log(10.0)


@dataclass(frozen=True, eq=False)
class Regression:
    """Gaussian posterior of the coefficients of a filtered series.

    Attributes:
        change: (p,), posterior mean, from the point of linearisation.
        covariance: (p, p).
        precision: (p,), of their prior.
        log_evidence: Logarithm of the probability density of the observations, up to a constant.
    """

    change: np.ndarray
    covariance: np.ndarray
    precision: np.ndarray
    log_evidence: float


def regress(filtered: Filtered, at: np.ndarray, precision: np.ndarray, pull: np.ndarray | float = 0.0) -> Regression:
    """Generalised least squares of the innovations, of deviations from a trajectory, on the coefficients.

    The trajectory's coefficients (p,) are ``at`` so many prior standard deviations from their prior mean; ``precision``
    (p,), of their prior, is in these, and ``pull`` (p,) is the derivative of what the misfit lacks, see
    :meth:`IteratedSmoother.pull_of_gains`.

    Raises:
        numpy.linalg.LinAlgError: The coefficients' information is not positive definite.
    """
    innovation = filtered.innovation.reshape(-1, filtered.innovation.shape[2])
    moments = innovation.T @ filtered.weighted.reshape(innovation.shape)
    log_spread = float(np.linalg.slogdet(filtered.spread)[1].sum())
    factor = cho_factor(moments[1:, 1:] + np.diag(precision), lower=True)
    change = -cho_solve(factor, moments[1:, 0] + precision * at + pull)
    squares = moments[0, 0] + moments[0, 1:] @ change + (precision * at) @ (at + change)
    determinant = 2.0 * np.log(np.diag(factor[0])).sum() - np.log(precision).sum()
    evidence = -0.5 * (log_spread + squares + determinant)
    return Regression(change, cho_solve(factor, np.eye(len(at))), precision, float(evidence))


@dataclass(frozen=True, eq=False)
class Pass:
    """One linearisation, filter and smoother.

    Attributes:
        levels: The noise levels.
        linearised: The model where it was linearised.
        filtered: Deviations from there.
        regression: Parameters and start of the motion.
        disturbances: (N, F), smoothed force that each equation leaves out, N.
        trajectory: The smoothed one.
        step: Rms of its distance from where the model was linearised, over its own rms; the largest of any state kind.
    """

    levels: NoiseLevels
    linearised: Linearised
    filtered: Filtered
    regression: Regression
    disturbances: np.ndarray
    trajectory: Trajectory
    step: float


class IteratedSmoother:
    """Most probable trajectory and parameters under given noise levels.

    Args:
        space: The model.
        passes: At most, for one noise level.
        learn_spread: Whether the common spread of the believed parameters is learned on the way.

    Attributes:
        held: (p,), coefficients that stay where they start.
        history: One row for every pass.
    """

    def __init__(self, space: StateSpace, passes: int, learn_spread: bool) -> None:
        self.space, self.passes, self.learn_spread = space, passes, learn_spread
        # Of unknown parameters nobody has said what they should be: only beliefs share how far they are off.
        believed = [not p.unknown and p.kind not in CALIBRATION_UNITS for p in space.problem.uncertain]
        self.sharing = np.array([*believed, *[False] * space.size])
        kinds = np.array([*(p.kind for p in space.problem.uncertain), *[""] * space.size])
        self.uncertain, self.gains, self.held = kinds != "", kinds == "gain", np.zeros(len(kinds), dtype=bool)
        self.history: list[dict[str, float]] = []
        self.started = time.perf_counter()

    def settle(self, trajectory: Trajectory, levels: NoiseLevels, tolerance: float) -> Pass:
        """Passes until the step is shorter than ``tolerance``, or until they are used up; see :meth:`once`."""
        self.space.follow_modes(trajectory)
        for _ in range(self.passes):
            done = self.once(trajectory, levels)
            trajectory = done.trajectory
            if done.step < tolerance:
                break
        return done

    def once(self, trajectory: Trajectory, levels: NoiseLevels) -> Pass:
        """One pass; a FloatingPointError says that it left the finite numbers."""
        linearised = self.space.linearise(trajectory)
        model = self.space.model(linearised, levels)
        filtered = model.filter()
        at, p = self.space.coefficients(trajectory), len(trajectory.parameters)
        try:
            pull = self.pull_of_gains(trajectory, filtered)
            precision = np.where(self.held, HELD_PRECISION, np.where(self.sharing, levels.spread**-2.0, 1.0))
            regression = regress(filtered, at, precision, pull)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise FloatingPointError(str(error)) from error
        move, disturbances = filtered.smooth(regression.change)
        length = self._length(trajectory, move)
        share = 1.0 if length < SHORT_STEP else self._share(trajectory, move, regression, filtered)
        moved = Trajectory(trajectory.states + share * move, trajectory.parameters + share * regression.change[:p])
        row = {"iteration": len(self.history) + 1, "seconds": time.perf_counter() - self.started}
        summary = {"discrepancy": levels.discrepancy, "log_evidence": regression.log_evidence, "step": length}
        self.history.append(row | summary)
        return Pass(levels, linearised, filtered, regression, disturbances, moved, length)

    def pull_of_gains(self, trajectory: Trajectory, filtered: Filtered) -> np.ndarray:
        """(p,), derivative of the logarithm of gain^taken by the coefficients.

        What is most probable together with one motion is a gain that is too large: smaller motions are more probable by
        their prior. Over all motions the density of a gain has a factor gain^-taken, with the values of its sensor that
        the motion takes up: the sum of the posterior variance of what the sensor shows over that of its noise.
        """
        space, out = self.space, np.zeros(len(self.held))
        gains = {space.problem.uncertain[i].index: i for i in np.flatnonzero(self.gains & ~self.held)}
        rows = {row: gains[s.channel.index] for row, s in enumerate(space.sensors) if s.channel.index in gains}
        if not rows:
            return out
        covariance, parameters = filtered.posterior()[0], space.parameters(trajectory)
        model = filtered.model
        for row, place in rows.items():
            seen = np.concatenate((model.state[:, row], model.disturbance[:, row]), axis=1)
            taken = np.einsum("ki,kij,kj->", seen, covariance, seen) / model.noise[row, row]
            parameter = space.problem.uncertain[place]
            out[place] = taken * parameter.prior_std / parameters["gain"][parameter.index]
        return out

    def _length(self, trajectory: Trajectory, move: np.ndarray) -> float:
        kinds = zip(*map(self.space.kinds, (trajectory.states + move, move)), strict=True)
        lengths = [np.sqrt(np.sum(y**2) / np.sum(x**2)) if y.any() else 0.0 for x, y in kinds]
        if not np.all(np.isfinite(lengths)):
            raise FloatingPointError("the smoothed trajectory is not finite")
        return float(max(lengths))

    def _share(self, trajectory: Trajectory, move: np.ndarray, regression: Regression, filtered: Filtered) -> float:
        """Largest of 1, 1/2, 1/4, ... of a step that makes the misfit less."""
        p, share = len(trajectory.parameters), 1.0
        before = self._misfit(trajectory, regression, filtered)
        for _ in range(HALVINGS):
            moved = Trajectory(trajectory.states + share * move, trajectory.parameters + share * regression.change[:p])
            if self._misfit(moved, regression, filtered) < before:
                break
            share /= 2.0
        return share

    def _misfit(self, trajectory: Trajectory, regression: Regression, filtered: Filtered) -> float:
        """Sum of squares that the smoother makes small, nonlinear; infinite where the motion overflows."""
        covariance, m = filtered.model.step_covariance, filtered.innovation.shape[1]
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = self.space.residuals(trajectory)
        if not np.all(np.isfinite(residuals)):
            return np.inf
        misfit = np.sum(residuals[:-1] * np.linalg.solve(covariance[:-1], residuals[:-1, :, None])[..., 0])
        misfit += residuals[-1, :m] @ np.linalg.solve(covariance[-1, :m, :m], residuals[-1, :m])
        return float(misfit + regression.precision @ self.space.coefficients(trajectory) ** 2)


def stiffened(smoother: IteratedSmoother, levels: NoiseLevels, wanted: float) -> Pass:
    """The pass under a wanted discrepancy, N, reached by decades from that of ``levels``; sensors settle under it.

    Raises:
        FloatingPointError: A level could not be smoothed.
    """
    decades = max(1, math.ceil(abs(math.log(levels.discrepancy / wanted, DECADE))))
    reached = first_pass(smoother, levels)
    for discrepancy in np.geomspace(levels.discrepancy, wanted, decades + 1):
        reached = smoother.settle(reached.trajectory, levels.with_discrepancy(float(discrepancy)), ROUGH)
    return best_levels(smoother, reached, searched=np.arange(len(levels.values)) != len(levels.sensors))


def most_probable(smoother: IteratedSmoother, levels: NoiseLevels) -> Pass:
    """The pass under the levels of greatest evidence; the levels start where the discrepancy is the force that acts.

    Gains in doubt are held first, and found from what comes of it: in a soft structure hardly anything tells a gain,
    and the search would carry it far off.

    Raises:
        FloatingPointError: Not even the softest level could be smoothed.
    """
    smoother.held = smoother.gains
    best = best_decade(smoother, first_pass(smoother, levels))
    if smoother.held.any():
        smoother.held = np.zeros_like(smoother.gains)
        softer = best.levels.with_discrepancy(DECADE * best.levels.discrepancy)
        best = best_decade(smoother, smoother.once(best.trajectory, softer))
    return best_levels(smoother, best)


def first_pass(smoother: IteratedSmoother, levels: NoiseLevels) -> Pass:
    """The motion from rest under prescribed parameters: what a structure at rest says of them is next to nothing."""
    held, smoother.held = smoother.held, smoother.uncertain
    first = smoother.once(smoother.space.start(), levels)
    smoother.held = held
    return first


def best_decade(smoother: IteratedSmoother, first: Pass) -> Pass:
    """The pass under the decade of greatest evidence, searched from soft physics to stiff.

    Every level starts at the last trajectory: soft physics forgives a start at rest, and each stiffer problem begins
    next to its solution.
    """
    best = smoother.settle(first.trajectory, first.levels, ROUGH)
    while best.levels.discrepancy > FINEST * first.levels.discrepancy:
        stiffer = best.levels.with_discrepancy(best.levels.discrepancy / DECADE)
        try:
            tried = smoother.settle(best.trajectory, stiffer, ROUGH)
        except FloatingPointError:
            break  # stiffer than these numbers can follow
        gain = tried.regression.log_evidence - best.regression.log_evidence
        best = tried if gain > 0.0 else best
        if gain < NEGLIGIBLE_GAIN:
            break
    return best


def best_levels(smoother: IteratedSmoother, best: Pass, searched: np.ndarray | bool = True) -> Pass:
    """All noise levels where the record is most probable, one pass a round; of (m + L,) those that are searched."""
    damping, searched = FIRST_CURVATURE, np.flatnonzero(searched & ~smoother.space.held)
    slope, curvature = slope_and_curvature(smoother, best)
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
            slope, curvature = slope_and_curvature(smoother, best)
    return best


def log_evidence(space: StateSpace, last: Pass) -> float:
    """That of the record and of what spectra show besides, of as many values as there are samples."""
    mask, levels = space.shown > 0.0, last.levels.values
    misfit = np.log(levels[mask] ** 2) + space.shown[mask] ** 2 / levels[mask] ** 2
    return float(last.regression.log_evidence - 0.5 * len(space.present) * np.sum(misfit))


def slope_and_curvature(smoother: IteratedSmoother, last: Pass) -> tuple[np.ndarray, np.ndarray]:
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
