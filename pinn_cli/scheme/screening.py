"""Where unknown masses and springs may start: linear structures that make of the measured force what the sensors saw.

Springs that are not linear count as the linear ones that come nearest. The misfit is smoothed over frequency, widely at
first: where a resonance lies next to the measured one, smoothing lets the two overlap, and the way downhill leads from
one to the other.

Where nobody measured what acts, every force is taken to be as strong as any other, with one power spectrum c omega^p,
and so is what begins a free decay. The level c and the slope p are those that fit best; what is left tells frequencies,
shapes and damping.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import doubts_of
from pinn_cli.scheme.linear_fit import (
    ABOVE_FLOOR,
    LAST_EVALUATIONS,
    START_EVALUATIONS,
    WIDTHS,
    JointFit,
    LinearFit,
    LinearStructure,
    what_acts,
)
from pinn_cli.system.frequency_response import Acting
from pinn_cli.system.modes import RIGID
from pinn_cli.system.structure import Structure

# Misfits of linear structures that explain much, so little that nothing can be said, and next to nothing.
MUCH, HOPELESS, NEARLY_NOTHING = 0.5, 0.9, 0.98
# Times as soft as the others may be what carries a structure: isolators, a foundation.
SOFTER_BELOW = 30.0
# Starts that go on to each width of the smoothing.
SURVIVORS = (6, 4, 3)
# The same of starts that are scattered about a structure, which are smoothed less: each mass and spring by a factor
# either way, and so many times all of them at random, with this standard deviation of their logarithms.
SCATTERED = (60, 8)
ONE_OFF, ALL_OFF, AT_RANDOM = np.log(2.5), 0.7, 12
# Ends with so many times the least misfit are worth a start.
RIVAL = 2.0
# Directions that are told least, along which others are looked for, and how many times as large as at either end a
# misfit is half-way between two valleys, but for rounding.
LOOSEST, ACROSS_A_RIDGE = 3, 1.001
# Times as large must a misfit be with a mass or a spring off by that factor that the record tells.
TOLD = 1.1
# Common factors on the stiffnesses that are tried per decade.
PER_DECADE = 8
# Starts whose masses and springs differ by less, as logarithms, are one.
SAME_START = 0.1
# Frequencies of a start: the highest lies above this part of the lowest that the record can tell, the lowest below so
# many times its highest.
SLOWEST, FASTEST = 0.5, 3.0


class PowerFit(LinearFit):
    """A record whose forces are not all measured: the misfit of the logarithms of its sensors' power spectra."""

    def __init__(self, record: Record, structure: LinearStructure) -> None:
        super().__init__(record, structure)
        identity = np.eye(record.ndof)
        self.acting = Acting.forces(identity if record.unforced.all() else identity[:, ~record.unforced])
        if record.misses_ground:
            nothing, carried = np.zeros_like(structure.influence), np.zeros(len(structure.stretch))
            self.acting = Acting.of([(nothing, structure.influence, carried)], len(nothing))

    def smooth(self, width: float) -> None:
        """See :meth:`LinearFit.smooth`."""
        s = self.spectra
        self.kernel = s.smoothing(width)
        sensed = self.kernel @ s.power
        self.weight = sensed / (sensed + ABOVE_FLOOR * s.floor)
        self.measured = np.log(np.maximum(sensed, 1e-300))
        at = np.log(self.kernel @ s.omega)
        together = np.stack((np.ones_like(at), at - at.mean()), axis=1)[:, None, :] * self.weight[..., None]
        self.basis, _ = np.linalg.qr(together.reshape(-1, 2))  # of level and slope, the same of all sensors
        self.size = float(np.sum(self._without_spectrum(self.weight * self.measured) ** 2))

    def residual(self, x: np.ndarray) -> np.ndarray:
        """(O, S) misfit of the logarithms."""
        value = self._response(x).value + self.ground_shown
        power = np.maximum(self.kernel @ np.sum(np.abs(value) ** 2, axis=2), 1e-300)
        return self._without_spectrum(self.weight * (np.log(power) - self.measured))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """(O, S, p), of the residual by the structure's unknowns."""
        value = self._response(x).value + self.ground_shown
        weight = self.weight / np.maximum(self.kernel @ np.sum(np.abs(value) ** 2, axis=2), 1e-300)
        by = [2.0 * np.sum((value.conj() * slope).real, axis=2) for slope in self._response_slopes(x)]
        return np.stack([self._without_spectrum(weight * (self.kernel @ slope)) for slope in by], axis=-1)

    def _without_spectrum(self, logarithms: np.ndarray) -> np.ndarray:
        """Weighed logarithms (O, S) without what the forces' spectrum can make up for."""
        flat = logarithms.reshape(-1)
        residual: np.ndarray = flat - self.basis @ (self.basis.T @ flat)
        return residual.reshape(logarithms.shape)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A linear chain that may be the measured one.

    Attributes:
        parameters: ``m`` to (n,); ``c``, ``k`` to (C,); ``loss``, of all springs, to (1,).
        misfit: Part of what forces and sensors have in common that it leaves unexplained, 0 to 1 and more.
        calibration: Name of a channel to its gain and its delay, s, where those are in doubt.
        unknowns: Of the fit that found it.
    """

    parameters: dict[str, np.ndarray]
    misfit: float
    calibration: dict[str, dict[str, float]] = field(default_factory=dict)
    unknowns: np.ndarray = field(default_factory=lambda: np.empty(0))


class Screening:
    """Linear structures that make of what acts what the sensors saw.

    Args:
        structure: How its coordinates and supports stretch its connections, and move with the ground.
        records: Each of which a candidate must fit; those whose forces are unknown are left out, unless all are.
        known: ``m`` to (n,), ``c`` and ``k`` to (C,), ``loss`` to (1,), NaN where unknown.
        guess: ``m``, ``k``, where the unknown ones may be: their ratios count, and one start is the guess.
    """

    def __init__(
        self,
        structure: Structure,
        records: Sequence[Record],
        known: Mapping[str, np.ndarray],
        guess: Mapping[str, np.ndarray],
    ) -> None:
        observed = [each for each in records if each.observed.any()]
        driven = [each for each in observed if what_acts(each)]
        doubts = doubts_of(driven)
        self.guess, self.records, self.model = guess, driven or observed, None
        self.is_driven = bool(driven)  # by what was measured
        if observed and (doubts or any(np.isnan(known[kind]).any() for kind in ("m", "k"))):
            linear = LinearStructure(structure, known, guess["k"])
            fits = [LinearFit(each, linear, doubts) for each in driven]
            # Where nobody measured what acts, resonances show in the sensors alone.
            self.model = JointFit(fits or [PowerFit(each, linear) for each in observed])

    def candidates(self) -> Iterator[Candidate]:
        """The best of those about the guess first; none where nothing is unknown.

        Noise makes several valleys of one: beside the best, others lie along what the record tells least. Where those
        in the ratios of the guess lead to none that explains much, what stands on the ground may be softer.
        """
        if self.model is None:
            return
        found = nearest(self.model, grid_of_starts(self.model, self.records, self.guess))
        if not self.is_driven:
            yield from found
        elif found[0].misfit < MUCH:
            best, *others = found
            yield best
            ends = [self.model.fitted(x, LAST_EVALUATIONS) for x in _least_told(self.model, best.unknowns)]
            others = _candidates(self.model, [*((one.misfit, one.unknowns) for one in others), *ends])
            yield from _of_other_valleys(self.model, best, others)
        else:
            self.model.smooth(WIDTHS[0])
            softer = np.where(self.model.structure.stretch.sum(axis=1) != 0.0, SOFTER_BELOW, 1.0)
            starts = grid_of_starts(self.model, self.records, {**self.guess, "k": self.guess["k"] / softer})
            found += nearest(self.model, starts)
            yield from _candidates(self.model, [(one.misfit, one.unknowns) for one in found])

    def others(self, best: Candidate) -> list[Candidate]:
        """What else the record may come from: of few sensors many structures make what these saw.

        First the best one with all that the spectra do not tell of it where the rest is, in the ratios of the guess;
        then those at which starts end that are scattered about the best, the best of these first.
        """
        if self.model is None:
            return []
        alike, scattered = _alike(self.model, best, self.guess), _scattered(self.model.structure, best)
        return [alike, *nearest(self.model, scattered, SCATTERED, WIDTHS[1:])]


def _least_told(model: JointFit, x: np.ndarray) -> list[np.ndarray]:
    """Starts to either side of x along masses and springs of which the record tells least, whatever else follows."""
    count = sum(len(model.structure.free[kind]) for kind in ("m", "k"))
    slopes, others = np.hsplit(model.slopes(x), [count])
    if others.shape[1]:
        slopes = slopes - others @ np.linalg.lstsq(others, slopes, rcond=None)[0]
    _, directions = np.linalg.eigh(slopes.T @ slopes)
    along = np.zeros((min(LOOSEST, count), len(x)))
    along[:, :count] = directions.T[: len(along)]
    along *= ONE_OFF / np.abs(along).max(axis=1, keepdims=True)
    return [x + sign * step for step in along for sign in (1.0, -1.0)]


def nearest(
    model: JointFit,
    starts: Sequence[np.ndarray],
    survivors: Sequence[int] = SURVIVORS,
    widths: Sequence[float] = WIDTHS,
) -> list[Candidate]:
    """The structures at which starts end, the best first; so many go on to each width of the smoothing."""
    ends, sharpest = list[tuple[float, np.ndarray]](), widths[0]
    for width, most in zip(widths, survivors, strict=False):
        model.smooth(width)
        starts = [model.aligned(x) for x in starts] if width == WIDTHS[0] else starts
        ranked = sorted((model.misfit(x), i) for i, x in enumerate(starts))
        starts = [starts[i] for _, i in ranked[:most]]
        nearer = _distinct(model.fitted(x, START_EVALUATIONS) for x in starts)
        if ends and ends[0][0] < MUCH and nearer[0][0] > NEARLY_NOTHING:
            model.smooth(sharpest)  # resonances that move with the amplitude have no sharper picture
            break
        ends, starts, sharpest = nearer, [x for _, x in nearer], width
    # Valleys that are long and flat, as noise makes them, have their bottoms far from where evaluations run out.
    worth = [(misfit, x) for misfit, x in ends if misfit <= RIVAL * ends[0][0]]
    return _candidates(model, [*(model.fitted(x, LAST_EVALUATIONS) for _, x in worth), *ends[len(worth) :]])


def grid_of_starts(model: JointFit, records: Sequence[Record], guess: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """The guess, and the best of many with a common factor on its stiffnesses or masses that the record can tell."""
    known, free = model.structure.known, model.structure.free
    mass, stiffness = (np.where(np.isnan(known[kind]), guess[kind], known[kind]) for kind in ("m", "k"))
    if not len(free["m"]) and not len(free["k"]):
        return [model.start(mass, stiffness)]
    connections = model.structure.stiffness(stiffness)
    factors = common_factors(model.structure.stretch, mass, connections, records, PER_DECADE)
    if not len(factors):
        return [model.start(mass, stiffness)]
    # Frequencies go with the root of either; where no stiffness is free it is the masses that are too large or small.
    lighter = np.ones_like(factors) if len(free["k"]) else factors
    tried = [model.start(mass / by, factor * stiffness) for factor, by in zip(factors, lighter, strict=True)]
    misfits = np.array([model.outline(x) if len(model.doubts) else model.misfit(x) for x in tried])
    valleys = [
        i
        for i in range(len(tried))
        if misfits[i] <= misfits[max(i - 1, 0)] and misfits[i] <= misfits[min(i + 1, len(tried) - 1)]
    ]
    valleys.sort(key=lambda i: misfits[i])
    return [model.start(mass, stiffness), *(tried[i] for i in valleys[: SURVIVORS[0]])]


def common_factors(
    stretch: np.ndarray, mass: np.ndarray, stiffness: np.ndarray, records: Sequence[Record], per_decade: int
) -> np.ndarray:
    """Factors on all stiffnesses (C,) at which records can tell a structure's frequencies; none where it has none.

    The coordinates that stretch each connection are (C, n), the masses (n,).
    """
    rates = np.linalg.eigvalsh(stretch.T @ (stiffness[:, None] * stretch) / np.sqrt(np.outer(mass, mass)))
    # A chain that is loose somewhere has frequencies of zero, which say nothing about its stiffness.
    stiff = rates[rates > RIGID * rates[-1]]
    if not stiff.size:
        return stiff
    slow, fast = np.sqrt(stiff[[0, -1]]) / (2.0 * np.pi)
    duration, band = max(each.duration for each in records), max(map(record_band, records))
    least, most = 2.0 * np.log10(SLOWEST / duration / fast), 2.0 * np.log10(FASTEST * band / slow)
    return np.asarray(10.0 ** np.linspace(least, most, max(2, int(per_decade * (most - least)))))


def _candidates(model: JointFit, ends: Iterable[tuple[float, np.ndarray]]) -> list[Candidate]:
    """Where fits ended, by their misfits, as structures."""
    return [Candidate(model.structure.parameters(x), misfit, model.calibration(x), x) for misfit, x in _distinct(ends)]


def _of_other_valleys(model: JointFit, best: Candidate, others: Iterable[Candidate]) -> Iterator[Candidate]:
    """The first of each: between two of one there is no ridge, as where a spring is stiff beside all others."""
    kept = [best]
    for one in others:
        pairs = [(0.5 * (one.unknowns + other.unknowns), max(one.misfit, other.misfit)) for other in kept]
        if all(model.misfit(half_way) > ACROSS_A_RIDGE * misfit for half_way, misfit in pairs):
            kept.append(one)
            yield one


def _distinct(ends: Iterable[tuple[float, np.ndarray]]) -> list[tuple[float, np.ndarray]]:
    """The best first, without those that ended where a better one did."""
    kept: list[tuple[float, np.ndarray]] = []
    for misfit, x in sorted(ends, key=lambda pair: pair[0]):
        if all(np.abs(x - other).max() > SAME_START for _, other in kept):
            kept.append((misfit, x))
    return kept


def _alike(model: JointFit, best: Candidate, guess: Mapping[str, np.ndarray]) -> Candidate:
    x, said = best.unknowns.copy(), model.start(guess["m"], guess["k"])
    model.smooth(WIDTHS[-1])
    most = TOLD * model.misfit(x)
    determined = np.array(
        [max(model.misfit(x - step), model.misfit(x + step)) > most for step in ONE_OFF * np.eye(len(x))]
    )
    masses, springs = (len(model.structure.free[kind]) for kind in ("m", "k"))
    for kind in (slice(0, masses), slice(masses, masses + springs)):
        if determined[kind].any():
            off = np.median((x - said)[kind][determined[kind]])
            x[kind] = np.where(determined[kind], x[kind], said[kind] + off)
    return Candidate(model.structure.parameters(x), model.misfit(x), best.calibration, x)


def _scattered(structure: LinearStructure, best: Candidate) -> list[np.ndarray]:
    """Each mass and spring larger or smaller by itself, and all of them at random; sensors stay."""
    x, springs = best.unknowns, len(structure.free["m"]) + len(structure.free["k"])
    one_by_one = [sign * ONE_OFF * row for row in np.eye(len(x))[:springs] for sign in (1.0, -1.0)]
    together = np.zeros((AT_RANDOM, len(x)))
    together[:, :springs] = ALL_OFF * np.random.default_rng(0).standard_normal((AT_RANDOM, springs))
    return [x + by for by in (*one_by_one, *together)]
