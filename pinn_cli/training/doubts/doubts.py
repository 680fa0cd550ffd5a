"""What the model may lack: how much more probable the record would be with one number more.

A doubt is a parameter that the model does not have: a force of a connection, a mass that is held, an oscillator on a
DOF, or what a sensor shows beside what it is said to feel. Its rows at the solution are a column. Columns and
residuals, with the motion projected out, are compared band by band, each of which has a level of its own
(`left_spectra`). The doubt with which the record is most probable is freed, and the others are asked again; what
either half of the record says of it must hold in the other one, and what later ones explain as well is dropped.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from pinn_cli.record.response import Response
from pinn_cli.system.functions import Jet
from pinn_cli.system.left_out import LINK, MODE, SPRING
from pinn_cli.system.modes import frequency_with_oscillator
from pinn_cli.system.parameters import FACTOR, MASS
from pinn_cli.system.priors import HALF_WIDTH_90
from pinn_cli.system.quantities import MOTION
from pinn_cli.training.doubts.force_doubts import ForceTerm, connection_force, force_border, force_terms, structure_at
from pinn_cli.training.doubts.left_spectra import Fit, LeftSpectra, highest_seen, left_spectra
from pinn_cli.training.doubts.sensor_doubts import DELAY, SensorTerm, Term, sensor_border, sensor_terms
from pinn_cli.training.estimate import Doubt, ParameterEstimate
from pinn_cli.training.factors.channel_at_point import ChannelAtPoint
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.elimination import Elimination
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution

# Least discrepancy over the rms force of the connections, and least noise of a sensor over the rms of the largest one
# of its kind. Stiffer equations take all but the last digits of a column's information; at a resonance of 1 % damping
# this much is half a per cent of the motion. What is smaller, far from where anything acts, is not asked.
LEAST_LEVEL = 1e-4
# Part of the motion, and of a mass or a stiffness, that no doubt takes away.
HALF, STIFF = 0.5, (MASS, SPRING, FACTOR)
# Logarithm of how many times as probable a record must be with a doubt: among some hundred doubts, by chance once in a
# hundred records.
DECISIVE_DOUBT = 10.0
# Share of its logarithm that what comes early has to lose against what comes late.
EARLY = 0.1
# Part of the first doubt's logarithm that a further one must have, or it may be what a linear test leaves of the first;
# and doubts that are told of one record.
FURTHER_SHARE = 0.1
MOST_CHOSEN = 3
# Share of the logarithm that a doubt keeps where either half of a record tells of the other, or it is refuted. Parts as
# long as each other are halves while each has so much of the motion; and the shortest half, over the record.
HELD_TRUE, LEAST_OF_MOTION, SHORTEST_HALF = 0.25, 0.25, 0.2
# How far the shapes of a term that is told are from each other, over those that are tried at first; in turn.
SPANS = (0.75, 0.25, 0.08)
# Columns for which the readout weights are solved at once: their copies are little beside the columns themselves.
SOLVED_AT_ONCE = 16
# Products of columns, at every readout weight, that are added up: some seconds, and a gigabyte. A larger record is not
# asked.
MOST_DOUBT_PRODUCTS = 2e10


# Something that a model may lack.
Lacking = ForceTerm | SensorTerm


def doubts(
    evidence: RecordEvidence, solution: RecordSolution, std: Response, parameters: Sequence[ParameterEstimate]
) -> tuple[Doubt, ...]:
    """What makes a record far more probable, the most probable one first; nothing where the model holds.

    The motion's standard deviation and the parameters are those that are reported.
    """
    equations, point = evidence.equations, solution.point
    # Where nobody measured a force, it is free to be what the model lacks.
    if equations.known_parameters is not None or evidence.problem.inputs.unmeasured:
        return ()
    reduced = _Solution.of(evidence, solution)
    if reduced is None:
        return ()
    forces = force_terms(equations, point, highest_seen(equations, reduced.channels))
    sensors = sensor_terms(reduced.channels)
    most = int((MOST_DOUBT_PRODUCTS / equations.layout.size) ** 0.5) - len(sensors)
    if len(forces) > most:  # of many DOFs the pairs are most of all
        forces = [force for force in forces if force.term.kind != LINK]
    if len(forces) > most:
        return ()
    chosen, gains = _chosen(reduced, forces, sensors)
    if not chosen:
        return ()
    asked = reduced.asked(chosen)
    fits = asked.fits(len(chosen))
    moved = reduced.moved_most(asked, fits[-1].step - fits[0].step, std, parameters)
    return tuple(asked.doubt(i, gain, fits, moved) for i, gain in enumerate(gains))


def _chosen(
    solution: _Solution, forces: Sequence[ForceTerm], sensors: Sequence[SensorTerm]
) -> tuple[list[Lacking], list[float]]:
    """What makes the record far more probable, one beside the other, and by how much, as logarithms."""
    chosen: list[Lacking] = []
    gains: list[float] = []
    refuted: set[tuple[str, str]] = set()
    candidates: list[Lacking] = [*forces, *sensors]
    for _ in range(MOST_CHOSEN):
        best, gain = _best(solution, chosen, candidates, refuted)
        if not gain > max([DECISIVE_DOUBT, *(FURTHER_SHARE * first for first in gains[:1])]):
            break
        if solution.gain_in_other_half([*chosen, best]) > HELD_TRUE * gain:
            chosen, gains, replaced = solution.asked([*chosen, best]).needed()
        else:
            replaced = [best]
        refuted |= {(term.term.kind, term.term.of) for term in replaced}
    for term, gain in zip(chosen, gains, strict=True) if len(chosen) > 1 else ():
        rest = [other for other in chosen if other is not term]
        best, of_best = _best(solution, rest, candidates, refuted)
        far = of_best > gain + DECISIVE_DOUBT and len(rest) < len(chosen)
        if far and solution.gain_in_other_half([*rest, best]) > HELD_TRUE * of_best:
            chosen, gains, _ = solution.asked([*rest, best]).needed()
    return chosen, gains


def _best(
    solution: _Solution,
    chosen: Sequence[Lacking],
    candidates: Sequence[Lacking],
    refuted: set[tuple[str, str]],
) -> tuple[Lacking, float]:
    """The candidate, in its best shape, that makes the record most probable beside those that are chosen."""
    open_terms = [term for term in candidates if (term.term.kind, term.term.of) not in refuted]
    best, gain = solution.asked([*chosen, *open_terms]).best(len(chosen))
    for span in SPANS if gain > DECISIVE_DOUBT else ():
        finer = best.finer(span) if isinstance(best, ForceTerm) else []
        if finer:
            best, gain = solution.asked([*chosen, *finer]).best(len(chosen))
    return best, gain


@dataclass(frozen=True, eq=False)
class _Solution:
    """A record's solution, with the readout weights eliminated.

    Attributes:
        equations: Of the record.
        point: Where they are solved.
        noise: Its weights.
        channels: Of the record.
        gradient: (size, 1), of the readout weights.
        readout: Factored.
        prior: (p, p), precision of what is believed of the parameters.
    """

    equations: NormalEquations
    point: Point
    noise: NoiseModel
    channels: list[ChannelAtPoint]
    gradient: np.ndarray
    readout: Elimination
    prior: np.ndarray

    @classmethod
    def of(cls, evidence: RecordEvidence, solution: RecordSolution) -> _Solution | None:
        """None where the equations cannot be solved."""
        equations, point = evidence.equations, solution.point
        noise = _softened(evidence, solution.noise, rms_force(equations, point))
        system = equations.assemble(point, noise)
        eliminated = system.eliminated()
        if eliminated is None:
            return None
        channels = [channel for group in equations.channels for channel in group.at(point, noise)]
        gradient = system.gradient[:, None]
        return cls(equations, point, noise, channels, gradient, eliminated.readout, solution.prior)

    def asked(self, terms: Sequence[Lacking]) -> _Asked:
        """Further parameters, of all of the record."""
        return self.asked_in_parts(terms, [(0.0, 1.0)])[0]

    def asked_in_parts(self, terms: Sequence[Lacking], parts: Sequence[tuple[float, float]]) -> list[_Asked]:
        """The same, of each part of the record, from and to over its duration; forces come first."""
        forces = [term for term in terms if isinstance(term, ForceTerm)]
        sensors = [term for term in terms if isinstance(term, SensorTerm)]
        self._move_by([f for f in forces if f not in self.moved_by], [s for s in sensors if s not in self.moved_by])
        in_order: list[Lacking] = [*forces, *sensors]
        # Products with sparse rows take it by rows.
        moved = np.column_stack((*self._moved_anyhow, *(self.moved_by[term] for term in in_order)))
        of_solution = self.equations, self.point, self.noise, self.channels
        spectra = [left_spectra(*of_solution, (forces, sensors), moved, self.prior, part) for part in parts]
        number = {term: i for i, term in enumerate(in_order, start=len(self.point.parameters))}
        places, grown = [number[term] for term in terms], self.growth @ moved[:, 1:]
        return [_Asked(self, terms, places, of_part, moved[:, 1:], grown) for of_part in spectra]

    @cached_property
    def free(self) -> list[int]:
        """Places of the parameters that no bound holds."""
        free: list[int] = np.flatnonzero(self.point.parameters.numpy() > self.equations.lower).tolist()
        return free

    @cached_property
    def moved_by(self) -> dict[Lacking, np.ndarray]:
        """How the motion adapts to each term that was asked for, (size,)."""
        return {}

    def _move_by(self, forces: list[ForceTerm], sensors: list[SensorTerm]) -> None:
        """Work out how the motion adapts to further terms."""
        if not forces and not sensors:
            return
        of_forces = force_border(self.equations, self.point, self.noise, forces)
        border = np.hstack((of_forces, sensor_border(self.equations, self.channels, sensors)))
        self.moved_by.update(zip([*forces, *sensors], self._adapted(border).T, strict=True))

    @cached_property
    def _moved_anyhow(self) -> tuple[np.ndarray, np.ndarray]:
        """(size, 1) and (size, p), how the motion adapts to the residual and to the parameters."""
        return self._adapted(self.gradient.copy()), -self.readout.solved_border

    def _adapted(self, border: np.ndarray) -> np.ndarray:
        """How the motion adapts to what pulls at the readout weights, (size, count), in the place of these."""
        for first in range(0, border.shape[1], SOLVED_AT_ONCE):
            part = border[:, first : first + SOLVED_AT_ONCE]
            still = np.zeros((len(self.point.parameters), part.shape[1]))
            part[:] = -self.readout.solved(self.readout.half_solved(part)[0], still)
        return border

    @cached_property
    def growth(self) -> np.ndarray:
        """(size,), by how much of itself the motion grows with every readout weight, on average over the sensors."""
        growth, sensors = np.zeros(self.equations.layout.size), [c for c in self.channels if c.quantity in MOTION]
        for channel in sensors:
            shown = channel.gain * channel.measurand
            pulled = channel.border(self.equations.layout, shown[:, None])[:, 0]
            growth += pulled / max(float(shown @ shown), 1e-300) / len(sensors)
        return growth

    def gain_in_other_half(self, terms: Sequence[Lacking]) -> float:
        """Logarithm of how many times as probable each half is with the last term, as the other half tells all of them.

        What stands in for something else in one part of a record does so in no other. Where one of them has hardly any
        motion both have as much of it: at the end of an earthquake nothing yields that yielded before.
        """
        halves = self.asked_in_parts(terms, ((0.0, self.middle), (self.middle, 1.0)))
        fits = [half.fits(len(terms))[-2:] for half in halves]
        gain = 0.0
        for other, (without, whole) in zip(reversed(halves), fits, strict=True):
            gain += other.spectra.minus_log_after(without.step) - other.spectra.minus_log_after(whole.step)
        return gain

    @cached_property
    def middle(self) -> float:
        """Share of the record at which half of it is over, by time or by the squares of the connections' forces."""
        over = (_connection_forces(self.equations, self.point) ** 2).sum(axis=1).cumsum()
        if LEAST_OF_MOTION <= over[len(over) // 2] / over[-1] <= 1.0 - LEAST_OF_MOTION:
            return 0.5
        middle = np.searchsorted(over, 0.5 * over[-1]) / len(over)
        return float(np.clip(middle, SHORTEST_HALF, 1.0 - SHORTEST_HALF))

    @cached_property
    def half_parameters(self) -> dict[int, float]:
        """Place of every stiffness and mass among the columns, to the step that is half of it."""
        distances, scale = self.point.parameters.tolist(), self.equations.scale.tolist()
        values = [
            (i, p.value(scale[i] * distances[i])) for i, p in enumerate(self.equations.uncertain) if p.kind in STIFF
        ]
        return {i: HALF * abs(value) / scale[i] for i, value in values}

    def frequency_of_whole(self, oscillator: ForceTerm, mass: float, step: np.ndarray) -> float:
        """Hz, of an attached oscillator with its DOF, in place of its own while the DOF is held; after a step."""
        by = torch.as_tensor(step[: len(self.point.parameters)]).to(self.point.parameters)
        present = structure_at(self.equations, Point(self.point.unknowns, self.point.parameters + by))
        pull = oscillator.distribution[: present.coordinates]
        return frequency_with_oscillator(present, pull, mass, oscillator.term.shape)

    def moved_most(
        self, asked: _Asked, by: np.ndarray, std: Response, parameters: Sequence[ParameterEstimate]
    ) -> tuple[float, str]:
        """Standard deviations by which what is reported moves with a step of the columns, of what moves most."""
        equations, like, std_of = self.equations, self.point.unknowns, {p.name: p.std for p in parameters}
        names, scale = [p.name for p in equations.uncertain], equations.scale.numpy()
        reported = [i for i in self.free if names[i] in std_of]  # not the state that a record goes on from
        moved = {names[i]: float(abs(by[i]) * scale[i]) / std_of[names[i]] for i in reported}
        along = Point(torch.as_tensor(asked.moved @ by).to(like), self.point.parameters)
        change = equations.flat_states(equations.observation, along)
        displacement = equations.dynamics.sensed("displacement", Jet(*change[:3])).numpy()
        for dof, (history, band) in enumerate(zip(displacement.T, std.displacement.T, strict=True)):
            name = f"the displacement of DOF {equations.problem.record.dof_name(dof)}"
            moved[name] = float(np.sqrt(np.mean(history**2) / np.mean(band**2)))
        furthest = max(moved, key=lambda name: moved[name])
        return float(moved[furthest]), furthest


@dataclass(frozen=True, eq=False)
class _Asked:
    """Terms that a model may lack.

    Attributes:
        solution: Beside which they are asked.
        terms: D of them.
        places: Of each, among the columns.
        spectra: Of the parameters of the model, and of the terms.
        moved: (size, columns), how the motion adapts to each.
        grown: (columns,), by how much of itself the motion grows with each.
    """

    solution: _Solution
    terms: Sequence[Lacking]
    places: list[int]
    spectra: LeftSpectra
    moved: np.ndarray
    grown: np.ndarray

    def fits(self, chosen: int) -> list[Fit]:
        """Without any term, and with one more of the first ones at a time."""
        fits = [self._fit([], self.spectra.energy)]
        for count in range(1, chosen + 1):
            fits.append(self._fit(self.places[:count], fits[-1].energy))
        return fits

    def _fit(self, places: Iterable[int], energy: np.ndarray) -> Fit:
        """With the columns at these places free as well; see :meth:`LeftSpectra.fit`."""
        return self.spectra.fit([*self.solution.free, *places], energy)

    def needed(self) -> tuple[list[Lacking], list[float], list[Lacking]]:
        """Terms with which the record is far more probable than with the others alone, by how much, and the rest.

        The most probable one is first. What was the best guess alone may stand in for what was found after it.
        """
        kept, whole = dict(zip(self.places, self.terms, strict=True)), self.fits(len(self.terms))[-1]
        rest: list[Lacking] = []
        while True:
            others = {place: [other for other in kept if other != place] for place in kept}
            gains = {place: whole.gain(self._fit(others[place], whole.energy), place) for place in kept}
            ranked = sorted(kept, key=lambda place: -gains[place])
            if gains[ranked[-1]] > DECISIVE_DOUBT or len(ranked) == 1:
                return [kept[place] for place in ranked], [gains[place] for place in ranked], rest
            rest.append(kept.pop(ranked[-1]))
            whole = self._fit(kept, whole.energy)

    def best(self, chosen: int) -> tuple[Lacking, float]:
        """The term that makes the record most probable beside the first ones, and its gain."""
        before, gains = self.fits(chosen)[-1], []
        named = {(candidate.term.kind, candidate.term.of) for candidate in self.terms[:chosen]}
        tried = Counter(candidate.term.kind for candidate in self.terms[chosen:])
        for candidate, place in zip(self.terms[chosen:], self.places[chosen:], strict=True):
            term = candidate.term
            gain = -np.inf if (term.kind, term.of) in named else self._gain(chosen, place, term, before)
            gains.append(gain - np.log(tried[term.kind]))  # of many that are tried, some are probable by chance
        best = int(np.argmax(gains))
        return self.terms[chosen + best], float(gains[best])

    def _gain(self, chosen: int, place: int, term: Term, before: Fit) -> float:
        """Logarithm of how many times as probable the record is with a term more."""
        fit = self._fit([*self.places[:chosen], place], before.energy)
        x, information = fit.step[place], max(fit.information[place], 1.0)
        # Equations of which nothing is left hold for any motion: without a measured force, a mass that goes to zero
        # with all that is unknown explains everything.
        wrong = not term.least < term.scale * (x - HALF_WIDTH_90 / information**0.5) or term.scale * x > term.most
        gain = fit.gain(before, place)
        # What explains something else at the price of where the structure moves stands in for what is not asked.
        moving = self.spectra.moving
        wrong |= fit.energy[moving].sum() > before.energy[moving].sum()
        # Where all of the motion is smaller, as where what acts is of an unknown gain, or nothing acts, less is left of
        # whatever is wrong.
        wrong |= float(self.grown @ fit.step) < -HALF
        # Nor does a linear step tell of a structure with half of a stiffness.
        wrong |= any(abs(fit.step[i]) > half for i, half in self.solution.half_parameters.items())
        # What comes late is more usual than what comes early: where all sensors are early, the load cell is late.
        early = EARLY * gain if term.kind == DELAY and x < 0.0 else 0.0
        return -np.inf if wrong else float(gain - early)

    def doubt(self, number: int, gain: float, fits: list[Fit], moved: tuple[float, str]) -> Doubt:
        """Of one of the terms; the last fit has all of them."""
        lacking, place, last = self.terms[number], self.places[number], fits[-1]
        term, shape = lacking.term, lacking.term.shape
        value, std = term.scale * last.step[place], term.scale / last.information[place] ** 0.5
        if term.kind == MODE and isinstance(lacking, ForceTerm):
            shape = self.solution.frequency_of_whole(lacking, float(value), last.step)
        energies = [float(fit.energy[self.spectra.moving].sum()) for fit in fits]
        share = (energies[number] - energies[number + 1]) / energies[0]
        return Doubt(term.kind, term.of, float(value), float(std), term.unit, gain, *moved, shape, share)


def _softened(evidence: RecordEvidence, noise: NoiseModel, force: float) -> NoiseModel:
    """Noise levels of which none is below `LEAST_LEVEL`; ``force`` is that of the connections, N, rms."""
    largest: defaultdict[str, float] = defaultdict(float)
    for sensor in evidence.sensors.values():
        quantity = sensor.channel.quantity
        largest[quantity] = max(largest[quantity], float(sensor.channel.measured.std()))
    response = dict(noise.response)
    for channels in evidence.equations.channels:
        kinds = [None if sensor is None else sensor.channel.quantity for sensor in channels.sensors]
        least = [np.nan if kind is None else LEAST_LEVEL * largest[kind] for kind in kinds]
        response[channels.name] = np.maximum(noise.response[channels.name], least)
    return replace(noise, discrepancy=max(noise.discrepancy, LEAST_LEVEL * force), response=response)


def rms_force(equations: NormalEquations, point: Point) -> float:
    """Of the connections, N."""
    return float(np.sqrt(np.mean(_connection_forces(equations, point) ** 2)))


def _connection_forces(equations: NormalEquations, point: Point) -> np.ndarray:
    """(P, C), at the collocation points."""
    return connection_force(equations, point, Jet(*equations.flat_states(equations.physics, point)[:3]))[2]
