"""Inputs that are functions to be found, as the record's own band tells them: how large they are, and of what colour.

They are the ground's acceleration, measured forces that are functions, and forces that nobody measured. The features
follow frequencies beyond the band, where a record shows that nothing acts. Counted with the others these would pull the
level of what drives an input down, and make bands too narrow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy.integrate import trapezoid
from scipy.special import chdtr, chdtrc, wrightomega

from pinn_cli.record.spectrum import USABLE_NYQUIST_FRACTION, white_level
from pinn_cli.scheme.modal_fit import IMPROBABLE_PART
from pinn_cli.scheme.problem import with_every_force
from pinn_cli.system.functions import FLAT, Inputs
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution

# Draws from the posterior that tell how many values of a residual, or of what drives the forces, the record determines.
DRAWS = 8
# Part of the drive in the band that must be determined: of less no level can be read.
LEAST_DETERMINED = 0.02
# Parts of the band, on a logarithmic axis, and corners that are tried over its edge; of what a model leaves out nothing
# is known above the band, and one of two corners is there.
PARTS, CORNERS, OF_LEFT_OUT = 16, np.geomspace(0.01, 2.0, 14), np.array([0.01, 0.03, 0.1, 0.3, 1.0])
# Forces end where their power falls to this part of it from one narrow part of the band to the next, and ratio of the
# frequencies at the ends of one; where it holds too few values, up to the second one. A nonlinear structure moves in a
# wider band than theirs: with what is driven there in the level of the forces a damper was 55 % too strong.
END, NARROW, NARROW_ENOUGH = 0.2, 1.08, 1.25
# Another spectrum must be so much more probable, as a logarithm.
DECISIVE_SPECTRUM = 3.0
# Frequencies that a part must have for its level to be told.
FEWEST_OF_PART = 16
# Prior standard deviation of the logarithm of one force's level about that of all: forces on one structure are of a
# kind. With 1.0 two sensors took one of three forces for nothing within 5 s; 60 s with three tell a seventh from all.
OF_A_KIND = 0.2
# What the forces would give a sensor above the band, over the power that it has there: about as much is theirs, and
# much less is noise beside which forces do not show.
OF_FORCES = (0.3, 3.0)


@dataclass(frozen=True, eq=False)
class Drive:
    """What drives unknown forces.

    Attributes:
        levels: (forces,) standard deviations per collocation point, N.
        correlation_time, damping_ratio: Of the process, see :class:`Inputs`.
    """

    levels: np.ndarray
    correlation_time: float
    damping_ratio: float


@dataclass(frozen=True, eq=False)
class DriveSpectrum:
    """The drive of the solution over the frequencies of a band.

    Attributes:
        frequency: (F,), Hz.
        power: (F, functions), N^2; of the ground (m/s^2)^2.
        determined: (F, functions), how many of its values the record determines.
    """

    frequency: np.ndarray
    power: np.ndarray
    determined: np.ndarray

    @property
    def is_enough(self) -> bool:
        """Whether a level can be read off it."""
        return float(self.determined.sum()) > LEAST_DETERMINED * len(self.determined)

    @property
    def levels(self) -> np.ndarray | None:
        """(functions,) standard deviations of the drive, per collocation point; None where they cannot be read."""
        return levels_of_a_kind(self.power.sum(0), self.determined.sum(0)) if self.is_enough else None

    @cached_property
    def end(self) -> float:
        """Where forces end, Hz: their power falls at once there, and stays low; infinity where it does nowhere.

        About the lowest such frequency, where the fall is most probable.
        """
        frequency, sums = self.frequency, np.zeros((len(self.frequency) + 1, 2))
        sums[1:] = np.cumsum(np.stack([self.power.sum(1), np.maximum(self.determined, 0.0).sum(1)], axis=1), axis=0)
        at = np.arange(1, len(frequency))
        wide, near, beyond, far = (
            np.searchsorted(frequency, frequency[at] * r)
            for r in (1 / NARROW_ENOUGH, 1 / NARROW, NARROW, NARROW_ENOUGH)
        )
        told = sums[:, 1]
        first = np.clip(np.searchsorted(told, told[at] - FEWEST_OF_PART, side="right") - 1, wide, near)
        stop = np.clip(np.searchsorted(told, told[at] + FEWEST_OF_PART), beyond, far)
        falls = np.ones(len(at), dtype=bool)
        for lower, upper in ((0, len(frequency)), (first, stop)):  # over all, and nearby
            (below, of_below), (above, of_above) = pair = (sums[at] - sums[lower]).T, (sums[upper] - sums[at]).T
            falls &= np.minimum(of_below, of_above) >= FEWEST_OF_PART
            falls &= above * of_below < END * below * of_above
        if not falls.any():
            return np.inf
        lowest = falls & (frequency[at] < NARROW * frequency[at[falls][0]])
        misfit = sum(n * np.log(power / n) for power, n in np.stack(pair)[..., lowest])
        both = np.sum(pair, axis=0)[:, lowest]
        return float(frequency[at[lowest][np.argmin(misfit - both[1] * np.log(both[0] / both[1]))] - 1])

    def up_to(self, frequency: float) -> DriveSpectrum:
        """That part of it, in Hz."""
        inside = self.frequency <= frequency
        return DriveSpectrum(self.frequency[inside], self.power[inside], self.determined[inside])


def levels_of_a_kind(squares: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(functions,) most probable standard deviations of what drives functions of one kind.

    Of all together sigma^2 = sum |n|^2 / sum (1 - var / sigma^2) (MacKay 1992): n is the drive of the solution, var its
    posterior variance. Each, times exp(y) of that, is where values (1 - exp(-2 y) squares / values) + y / s^2 is zero,
    with a normal prior of y: one of which nothing is determined is as large as all, one that is determined is its own.

    Args:
        squares: (functions,), sum |n|^2.
        values: (functions,), how many values of the drive the record determines.
    """
    together = squares.sum() / values.sum()
    tight = np.maximum(values, 0.0) * OF_A_KIND**2
    with np.errstate(divide="ignore"):
        omega = wrightomega(2.0 * tight + np.log(2.0 * OF_A_KIND**2 * squares / together))
    levels: np.ndarray = np.sqrt(together) * np.exp(omega / 2.0 - tight)
    return levels


def level_in_band(evidence: RecordEvidence, solution: RecordSolution) -> np.ndarray | None:
    """:attr:`DriveSpectrum.levels` of the unknown forces; None without any."""
    seen = _of_forces(evidence, solution)
    return None if seen is None else seen.levels


def spectrum_in_band(evidence: RecordEvidence, solution: RecordSolution) -> Drive | None:
    """The drive of the most probable spectrum of the unknown forces; None where that is the present one.

    Flat up to a corner, or falling off from a lower to an upper one. That may lie beyond the forces' band, since a
    process of second order falls off before it: else coloured wind gave stiffnesses that were 6 deviations off.
    """
    seen, inputs = _of_forces(evidence, solution), evidence.equations.problem.inputs
    if seen is None or not seen.is_enough:
        return None
    present = _gain(inputs.correlation_time, inputs.damping_ratio, seen.frequency)
    (now, _), (likelihood, best) = _fitted(seen, inputs, present)
    return best if likelihood > now + DECISIVE_SPECTRUM else None


def std_and_misfit(evidence: RecordEvidence, solution: RecordSolution) -> tuple[float, float | None]:
    """Of the unknown forces in their band, where there are any: standard deviation, and how far off their spectrum is.

    Returns:
        Root mean square of all (N; of a ground m/s^2). Of a process whose corner lies beyond the record's band, what it
        would do there is none of the record's. And see :func:`_misfit`; None where the record determines too little of
        every force.
    """
    equations, inputs, innovation = evidence.equations, evidence.equations.problem.inputs, solution.noise.innovation
    assert innovation is not None
    variance, seen = innovation[equations.dynamics.forces] ** 2, _of_forces(evidence, solution)
    told = seen if seen is not None and seen.is_enough else None
    top = inputs.edge / (2.0 * np.pi) if told is None else float(told.frequency[-1])
    frequency = np.linspace(0.0, top, 2001)
    share = trapezoid(_gain(inputs.correlation_time, inputs.damping_ratio, frequency) ** -2.0, frequency)
    step = equations.problem.record.step / equations.refinement
    return float(np.sqrt(2.0 * step * share * np.mean(variance))), None if told is None else _misfit(told, variance)


def _misfit(seen: DriveSpectrum, variance: np.ndarray) -> float:
    """Relative, how far the power of a force is off its spectrum in a part of the band, beyond chance; 0: no part is.

    The variance (functions,) is that of what drives the forces, by their spectrum.
    """
    part = parts_of(seen.frequency)
    power, values = (sums_by_part(part, x) for x in (seen.power, np.maximum(seen.determined, 0.0)))
    told = values > FEWEST_OF_PART
    squares, values = (power / variance)[told], values[told]
    by_chance = 2.0 * len(values) * np.minimum(chdtr(2.0 * values, 2.0 * squares), chdtrc(2.0 * values, 2.0 * squares))
    return float(np.abs(squares / values - 1.0)[by_chance < IMPROBABLE_PART].max(initial=0.0))


def spectrum_of_discrepancy(evidence: RecordEvidence, solution: RecordSolution) -> Drive | None:
    """What would drive forces in the place of the discrepancy, which is as it is; None where it cannot be read."""
    equations, inputs = evidence.equations, with_every_force(evidence.equations.problem).inputs
    of_motion = slice(0, equations.dynamics.ndof)
    seen = drive_below(evidence, all_driven(solution), of_motion, inputs.edge / (2.0 * np.pi))
    if seen is None or not seen.is_enough:
        return None
    return _fitted(seen, inputs, np.ones_like(seen.frequency))[1][1]


def all_driven(solution: RecordSolution) -> RecordSolution:
    """The same under white noise that drives the motion as well, instead of a discrepancy."""
    noise = solution.noise
    return replace(solution, noise=replace(noise, innovation=np.sqrt(noise.physics_variance)))


def _fitted(
    seen: DriveSpectrum, inputs: Inputs, present: np.ndarray
) -> tuple[tuple[float, Drive], tuple[float, Drive]]:
    """How probable the present spectrum is, and the most probable one, with what drives the process then.

    ``present`` (F,) is the gain from a force to what drives it now, which is what was seen.
    """
    part = parts_of(seen.frequency)

    def fit(correlation_time: float, damping_ratio: float) -> tuple[float, Drive]:
        """Whittle's likelihood of the parts, and what drives the process at its most probable level."""
        ratio = (_gain(correlation_time, damping_ratio, seen.frequency) / present)[:, None] ** 2
        values = np.maximum(seen.determined, 0.0)
        power, known, shape = (sums_by_part(part, x) for x in (seen.power * ratio, values, values * np.log(ratio)))
        levels = levels_of_a_kind(power.sum(0), known.sum(0))
        likelihood = float((shape - known * np.log(levels**2) - power / levels**2).sum())
        return likelihood, Drive(levels, correlation_time, damping_ratio)

    corners = (OF_LEFT_OUT, OF_LEFT_OUT[-1:]) if inputs.left_out else (CORNERS, CORNERS)
    processes = _processes(2.0 * np.pi * seen.frequency[-1], *corners)
    best = max((fit(*process) for process in processes), key=lambda fitted: fitted[0])
    return fit(inputs.correlation_time, inputs.damping_ratio), best


def _processes(edge: float, lower: np.ndarray, upper: np.ndarray) -> list[tuple[float, float]]:
    """Correlation times and damping ratios: flat to a corner, or falling off from a lower to an upper one.

    Corners are over the edge of the forces' band, rad/s.
    """
    pairs = [(low, high) for low in lower for high in upper if low <= high]
    falling = [((1.0 / low + 1.0 / high) / edge, 0.5 * (low + high) / (low * high) ** 0.5) for low, high in pairs]
    return falling + [(2.0 * FLAT / (corner * edge), FLAT) for corner in upper]


def _gain(correlation_time: float, damping_ratio: float, frequency: np.ndarray) -> np.ndarray:
    """From a force to what drives it."""
    omega = 2.0 * np.pi * frequency
    return np.hypot(1.0 - (omega * correlation_time / (2.0 * damping_ratio)) ** 2, omega * correlation_time)


def reaches_beyond(evidence: RecordEvidence, solution: RecordSolution) -> float:
    """How many times the band the unknown forces reach; 1 where it is as far as they do.

    Forces that are white shake a mass at all frequencies. What a sensor shows above the frequencies of the structure is
    then flat, and passes for its noise. It is the forces' own where these, as large as they are in the band, would give
    it just that.
    """
    levels, equations = level_in_band(evidence, solution), evidence.equations
    record, inputs, structure = equations.problem.record, equations.problem.inputs, equations.dynamics.structure
    top = inputs.edge / (2.0 * np.pi)
    wider = USABLE_NYQUIST_FRACTION * 0.5 / record.step / top
    if levels is None or structure.is_modal or wider < 1.1:
        return 1.0
    mass = equations.prescribed["m"].numpy()
    share = [
        # White noise of the points has so much power per frequency less than that of the samples.
        (level / mass[dof] / white_level(acceleration, record.step, top)) ** 2 / equations.refinement
        for dof, level in zip(inputs.forces, levels, strict=False)  # a ground pushes at none
        if np.isfinite(acceleration := record.acceleration[:, dof]).all()
    ]
    return wider if share and OF_FORCES[0] < np.median(share) < OF_FORCES[1] else 1.0


def parts_of(frequency: np.ndarray) -> np.ndarray:
    """(F,), in which part of the band each frequency is."""
    edges = np.geomspace(max(frequency[0], 1e-3 * frequency[-1]), frequency[-1], PARTS + 1)
    return np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, PARTS - 1)


def sums_by_part(part: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(PARTS, functions), sums of (F, functions)."""
    return np.stack([np.bincount(part, of_function, PARTS) for of_function in values.T], axis=-1)


def _of_forces(evidence: RecordEvidence, solution: RecordSolution) -> DriveSpectrum | None:
    """What drives the unknown forces, as far as they reach in the record's band; None without any."""
    inputs = evidence.equations.problem.inputs
    seen, edge = drive_in_record(evidence, solution), inputs.edge / (2.0 * np.pi)
    return None if seen is None else seen.up_to(edge if inputs.left_out else min(edge, seen.end))


def drive_in_record(evidence: RecordEvidence, solution: RecordSolution) -> DriveSpectrum | None:
    """What drives the unknown forces, at all frequencies that the samples tell; None without any."""
    equations = evidence.equations
    return drive_below(evidence, solution, equations.dynamics.forces, 0.5 / equations.problem.record.step)


def drive_below(
    evidence: RecordEvidence, solution: RecordSolution, functions: slice, top: float
) -> DriveSpectrum | None:
    """What drives some functions, up to a frequency (Hz); None without any, or without averages over intervals."""
    equations, point = evidence.equations, solution.point
    innovation, averages = solution.noise.innovation, equations.averages
    if functions.start == functions.stop or innovation is None or averages is None:
        return None
    rate = equations.network.free_intervals

    def power(residual: torch.Tensor) -> np.ndarray:
        drive = averages.by_interval(residual)[:, functions].numpy()
        squares: np.ndarray = np.abs(np.fft.rfft(drive, axis=0)) ** 2 / len(drive)
        return squares

    spectrum = power(equations.motion.residual(point))
    moved = [functions_moved for _, functions_moved in equations.motion.moved(point, solution.drawn(DRAWS))]
    scatter = np.zeros_like(spectrum)
    for of_draw in zip(*moved, strict=True):
        scatter += power(torch.cat(of_draw)) / DRAWS
    determined = 1.0 - scatter / innovation[functions] ** 2
    frequency = rate * np.arange(len(spectrum)) / (2.0 * (len(spectrum) - 1))
    inside = (frequency > 0.0) & (frequency <= top)
    return DriveSpectrum(frequency[inside], spectrum[inside], determined[inside])
