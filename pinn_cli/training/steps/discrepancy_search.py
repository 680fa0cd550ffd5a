"""The search for the model error that makes a record, or several together, most probable."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.least_squares import LeastSquares
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_scales import newtons

# The scan over the discrepancy goes down by this factor, half a decade; all levels settle together afterwards.
SCAN_FACTOR = 10.0**0.5
# Where the evidence rises by more than this from one solution to the next, the peak is far: then steps are twice as
# long, while they take no more than so many factorisations.
FAR_FROM_THE_PEAK, EASILY_FOLLOWED = 200.0, 3
# A drop of the log evidence by this much ends the scan: the odds against anything stiffer are e^-20.
DECISIVE_DROP = 20.0
# Where a solution runs into its limit of iterations it goes on so many times; a scan ends where it still does not end.
GOING_ON = 3
# The scan also ends after this many steps without a gain, or at this fraction of the force that it began with.
PATIENCE, FINEST_OF_START = 3, 1e-8
# A discrepancy below this part of the noise of every measured input makes no motion better known: one step without a
# gain ends the scan there.
FINEST_OF_NOISE = 1e-2
# Nor does one below this part of what drives a force that nobody measured. Far below it rounding is all that the normal
# matrix has left of slow motion, whose bands were then several times too narrow.
FINEST_OF_DRIVE = 3e-4
# A model error above this part of the force is either a model that is far off or a search that went astray: it is worth
# a second search from another start.
SUSPICIOUS_DISCREPANCY = 0.01
# Physics as soft as the force that acts is nearly linear, but says next to nothing of some laws: their most probable
# parameters there may be anything (a spring gone, a hysteresis turned round), from where no way leads back. Where more
# than so many steps are refused there, the parameters are held at their start with this part of their prior's deviation
# instead, the less firmly the stiffer the physics, and let go where a model would be a good one. Of linear structures
# the starts were chosen by spectra already, and soft physics brings them together.
FRUITLESS_IF_EASY = 1
HELD_AT_START = 0.01
# Solutions under the same discrepancy are one if no parameter differs by more of its deviation: they are in the same
# valley, and what they still differ by is what each start believes.
SAME_SOLUTION = 0.1
# A start that is behind another one by so much log evidence, and by more at the next smaller discrepancy, is given up:
# what is a wrong valley is so the more, the less the discrepancy explains.
OUTDONE = 200.0
# Gain in log evidence below which another solution is not worth it. A scan ends where a step of a good model changes it
# by less: what is stiffer is as probable, and the levels that settle afterwards are the same.
NEGLIGIBLE_GAIN = 0.5


class NothingNew(Exception):  # noqa: N818 - it is no error
    """A search comes to where an earlier one of the same problem was, or falls further and further behind it."""


class Path:
    """Solutions on the way from soft physics to stiff, from one start of the parameters.

    Args:
        earlier: Those from other starts.

    Attributes:
        earlier: Likewise.
        leads_nowhere: Whether even noisier sensors led to no model that explains something.
    """

    def __init__(self, earlier: Sequence[Path]) -> None:
        self.earlier, self.leads_nowhere = earlier, False
        self._found, self._evidence, self._behind = dict[float, np.ndarray](), dict[float, float](), 0.0

    def follow(self, equations: LeastSquares, trained: Trained) -> None:
        """Note a solution.

        Raises:
            NothingNew: An earlier path had it, or others that are far more probable, here and a step before.
        """
        discrepancy = trained.noise.discrepancy
        self._evidence[discrepancy] = trained.log_evidence
        others = [path._evidence[discrepancy] for path in self.earlier if discrepancy in path._evidence]
        behind = max(others, default=-np.inf) - trained.log_evidence
        if behind > self._behind > OUTDONE:
            raise NothingNew
        self._behind = behind
        if not trained.solution.converged:
            return
        scale, prescribed = equations.scale, np.array([p.prescribed for p in equations.uncertain])
        values = prescribed + scale * trained.solution.point.parameters.numpy()
        std = scale * np.sqrt(np.diag(trained.factor.corner_covariance))
        self._found[discrepancy] = values
        for path in self.earlier:
            if discrepancy in path._found and np.all(abs(path._found[discrepancy] - values) < SAME_SOLUTION * std):
                raise NothingNew


def searched(
    evidence: Evidence,
    noise: NoiseLevels,
    second_start: Callable[[], Point | None],
    path: Path | None = None,
) -> Trained:
    """The most probable discrepancy of a scan, from rest and, where that finds no good model, from another start.

    Where a structure is strongly nonlinear, the motion that soft physics finds may lie in the wrong valley.

    Args:
        evidence: Of the problem.
        noise: See :func:`scanned`.
        second_start: Another motion to begin with; None: there is none.
        path: Of the scan from rest.

    Raises:
        NothingNew: See :class:`Path`.
        DivergenceError: Even the softest physics cannot be solved.
    """
    force = noise.discrepancy
    first = scanned(evidence, noise, force, evidence.equations.start(), path)
    if holds(first, force):
        return first
    start = second_start()
    if start is None:
        return first
    try:
        second = scanned(evidence, noise, SUSPICIOUS_DISCREPANCY * force, start)
    except DivergenceError:
        return first
    return max(first, second, key=lambda trained: trained.log_evidence)


def holds(trained: Trained, force: float) -> bool:
    """Whether a solution is a good model of its record, under the force that acts, N."""
    return leaves_less_than(trained, SUSPICIOUS_DISCREPANCY * force)


def leaves_less_than(trained: Trained, force: float) -> bool:
    """Whether there is a solution, and what it leaves out is less than a force, N."""
    return trained.solution.converged and trained.noise.discrepancy < force


def scanned(evidence: Evidence, noise: NoiseLevels, largest: float, start: Point, path: Path | None = None) -> Trained:
    """The most probable discrepancy of a scan from soft physics to stiff, with the spread of the parameters there.

    Every solution starts at the last. Soft physics is nearly linear and forgives a start at rest; each stiffer
    problem begins next to its solution. So the search for the noise level is also the continuation that long and
    stiff records need.

    Args:
        evidence: Of the problem.
        noise: Sensor noise; its discrepancy is the force that acts.
        largest: Where to begin, N: with a start at rest the force that acts.
        start: The motion to begin with.
        path: Of the solutions, where there are other starts.

    Raises:
        NothingNew: See :class:`Path`.
        DivergenceError: The first problem cannot be solved.
    """
    point, discrepancy, idle, stride = start, largest, 0, SCAN_FACTOR
    force, is_held = noise.discrepancy, False
    is_soft = largest > SUSPICIOUS_DISCREPANCY * force
    may_stray = is_soft and not evidence.problem.first.structure.has_linear_laws
    best: Trained | None = None
    indifferent = min(filter(None, map(negligible, evidence.equations.by_record, noise.records)), default=0.0)
    while discrepancy > FINEST_OF_START * largest and idle < PATIENCE:
        levels = noise.with_discrepancy(discrepancy)
        trained = evidence.train(_held(levels, force) if is_held else levels, point)
        if may_stray and (trained is None or trained.solution.fruitless > FRUITLESS_IF_EASY):
            is_held, may_stray = True, False
            continue
        may_stray = False
        followed = best is not None and best.solution.converged
        if followed and stride <= SCAN_FACTOR:
            trained = _ended(evidence, trained)
        failed = trained is None or (followed and not trained.solution.converged)
        gain = trained.log_evidence - best.log_evidence if trained is not None and best is not None else np.inf
        if stride > SCAN_FACTOR and (failed or gain < 0.0):  # beyond what can be followed, or beyond the peak
            discrepancy, stride = discrepancy * stride / SCAN_FACTOR, SCAN_FACTOR
            continue
        if trained is None or failed:
            break  # stiffer than these steps or these numbers can follow
        if path is not None:
            path.follow(evidence.equations, trained)
        stride = SCAN_FACTOR**2 if best is not None and _is_easy(best, trained) else SCAN_FACTOR
        point, noise = trained.solution.point, replace(noise, spread=evidence.learned_spread(trained))
        idle = 0 if best is None or gain > 0.0 else idle + 1
        best = trained if best is None or idle == 0 else best
        flat = abs(gain) < NEGLIGIBLE_GAIN and discrepancy < SUSPICIOUS_DISCREPANCY * force
        if gain < -DECISIVE_DROP or (idle and discrepancy < indifferent) or flat:
            break
        discrepancy /= stride
        del trained  # before the next is made
    if best is None:
        reason = "the softest physics already has a singular normal matrix; use fewer knots or more sensors"
        raise DivergenceError(reason)
    let_go = evidence.train(replace(best.noise, firmness=0.0), best.solution.point) if best.noise.firmness else best
    return let_go or best


def _ended(evidence: Evidence, trained: Trained | None) -> Trained | None:
    """A solution, begun again where it ran into its limit of iterations, see :data:`GOING_ON`."""
    for _ in range(GOING_ON):
        if trained is None or trained.solution.converged:
            break
        trained = evidence.train(trained.noise, trained.solution.point)
    return trained


def _held(noise: NoiseLevels, force: float) -> NoiseLevels:
    """Levels on the way from soft physics to stiff, with the parameters held as firmly as they must be there."""
    return replace(noise, firmness=max(noise.discrepancy / force - SUSPICIOUS_DISCREPANCY, 0.0) / HELD_AT_START)


def negligible(equations: NormalEquations, noise: NoiseModel) -> float:
    """The discrepancy of one record, N, below which no motion is better known; 0 where inputs do not tell."""
    driven = np.zeros(0) if noise.innovation is None else noise.innovation[equations.dynamics.forces]
    drive = float(np.min(driven * newtons(equations.problem))) if len(driven) else 0.0
    return max(FINEST_OF_NOISE * noise.least_of_inputs, FINEST_OF_DRIVE * drive)


def _is_easy(before: Trained, after: Trained) -> bool:
    """Whether a scan that goes on like that is still far from the peak, and may take longer steps to it."""
    is_far = after.log_evidence - before.log_evidence > FAR_FROM_THE_PEAK
    is_quick = after.solution.factorisations <= EASILY_FOLLOWED and not after.solution.damping
    return before.solution.converged and after.solution.converged and is_far and is_quick
