"""Where unknown parameters start, and how far they may go: what the user says, else what the structure must be like.

Masses, dampers and springs come from linear chains that make of the measured force what the sensors saw
(:mod:`pinn_cli.scheme.screening`); several where noise may have put the right one behind another. Where none explains
half of that, what is said of the springs keeps its ratios in another start, and the free run of a structure that is not
linear tells how stiff they are together. Where no force is known, they come from the record's own scale.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np

from pinn_cli.record.channels import channels, motion_amplitudes
from pinn_cli.record.cross_spectra import CrossSpectra, misses_samples
from pinn_cli.record.free_run import NoFreeRunError, affordable, free_run, is_linear
from pinn_cli.record.record import Record
from pinn_cli.scheme.linear_fit import ABOVE_FLOOR, STARTING_RATIO, WIDTHS, last_ends, lines_in_band
from pinn_cli.scheme.screening import (
    HOPELESS,
    MUCH,
    NEARLY_NOTHING,
    RIVAL,
    SAME_START,
    Candidate,
    Screening,
    common_factors,
)
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_whole_number
from pinn_cli.system.damping import of_ratio
from pinn_cli.system.parameters import FACTOR, LINEAR_UNITS, MASS, Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.system.structure import Structure

AUTO, GIVEN = "auto", "given"
# Damping ratios of structures that may start.
RATIOS = 1e-3, 0.3
# Where no linear chain comes near, free runs take so many common factors on the springs in a decade, in so many decades
# either way.
FREE_RUNS, DECADES_OFF = 4, 2.0
# Candidates that are worth a start, at most, and times the least misfit of those that noise may have put behind it.
MOST_RIVALS, AS_NEAR = 3, 1.25


def parameter_scales(structure: Structure, records: Sequence[Record]) -> dict[str, np.ndarray]:
    """Kind of parameter to the values with which each alone would carry the force that acts, at the motion that is.

    With F, U, V, A the root mean squares of force, displacement, velocity and acceleration: m is F / A, c is F / V, k
    is F / U, and a nonlinear parameter is F over the force that a value of one makes at (U, V). Only orders of
    magnitude: an elongation is not a displacement. Of several records the median counts.
    """
    by_record = [_scales(structure, record) for record in records]
    return {kind: np.median([scales[kind] for scales in by_record], axis=0) for kind in by_record[0]}


def _scales(structure: Structure, record: Record) -> dict[str, np.ndarray]:
    size = motion_amplitudes(record)
    measured = record.force[:, record.sensors("force")]
    force = float(np.sqrt(np.mean(measured**2))) if measured.size else 0.0
    masses = structure.parameters[MASS].detach().cpu().double().numpy()
    known_masses = masses[np.isfinite(masses) & (masses > 0)]
    if not force > 0:  # that of the masses; where nobody knows those either, of one kilogram
        force = size["acceleration"] * (float(np.median(known_masses)) if known_masses.size else 1.0)
    scales = {"m": np.full(len(masses), force / size["acceleration"])}
    # Laws may call parameters of other units by one letter: each has a scale of its own.
    for kind, alone in unit_forces(structure, size["displacement"], size["velocity"]).items():
        scales[kind] = np.divide(force, alone, out=np.ones_like(alone), where=alone > 0)
    return scales


def unit_forces(structure: Structure, elongation: float, rate: float) -> dict[str, np.ndarray]:
    """Kind of the connections' parameters to the size of the force that a value of one makes alone (members,), N.

    Every connection has this elongation, m, and this rate, m/s; the structure's own parameters are not read.
    """
    e, de = (np.full(structure.incidence.shape[0], value) for value in (elongation, rate))
    forces = {}
    for kind, members in structure.members.items():
        alone = {name: np.full(len(values), float(name == kind)) for name, values in structure.parameters.items()}
        forces[kind] = np.abs(structure.connection_force(e, de, alone)[members])
    return forces


@dataclass(frozen=True)
class Start:
    """Where one unknown parameter starts, and its order of magnitude.

    Attributes:
        value: Of the start.
        scale: What it would be where it matters.
        prior_scale: What its prior is counted in; None: the same.
    """

    value: float
    scale: float
    prior_scale: float | None = None


def calibrated(records: Sequence[Record], start: Mapping[Parameter, Start]) -> list[Record]:
    """The records whose sensors' unknown gains and delays start where a start has them.

    Parameters of the structure may stand in it.
    """
    by_sensor: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for parameter, found in start.items():
        if parameter.kind in CALIBRATION_UNITS:
            by_sensor[parameter.label][parameter.kind] = found.value
    return [record.started_at(by_sensor) for record in records]


def checked_starts(starts: Any) -> int | None:
    """``scheme.starts`` as the number of starts at most; None: as many as the record leaves open; 0: what was given.

    Raises:
        InputError: Neither ``auto`` nor ``given`` nor a positive whole number.
    """
    if starts in (AUTO, GIVEN):
        return None if starts == AUTO else 0
    if not is_whole_number(starts) or starts < 1:
        raise InputError("scheme.starts", starts, "auto, given, or a whole number >= 1")
    return int(starts)


@dataclass(frozen=True, eq=False)
class Starts:
    """Starts of the unknown parameters.

    Args:
        prescribed: The model; NaN where a measured structure has no value.
        records: What was measured, of one structure.
        unknown: The unknown parameters.
        given: What the user says of them. Of masses and springs their ratios count, and one start is what was given; a
            damper or a nonlinear parameter starts there.
        most: Starts at most; None: those that compete, and what was given; 0: that alone, whatever the record says.
    """

    prescribed: Structure
    records: Sequence[Record]
    unknown: Collection[Parameter]
    given: Mapping[Parameter, float]
    most: int | None

    def __iter__(self) -> Iterator[dict[Parameter, Start]]:
        """The most promising first."""
        if self.prescribed.is_modal:
            return iter([self._at(_of_modes(self.prescribed, self.unknown, self.given))])
        return map(self._start, self.promising)

    def elsewhere(self) -> list[dict[Parameter, Start]]:
        """Starts for where those led to no model that holds: linear structures that fit as well, about the best."""
        searched = any(p.kind in (MASS, "k") for p in self.unknown) and not self.prescribed.is_modal
        if self.most is not None or not searched or not self._linear:
            return []
        alike, *others = self._screening.others(self._linear[0])
        rivals: list[Candidate] = []
        for candidate in (alike, *(c for c in others if c.misfit <= RIVAL * self._linear[0].misfit)):
            if all(_are_distinct(candidate, taken, self.unknown) for taken in (*self.promising, *rivals)):
                rivals.append(candidate)
        return [self._start(candidate) for candidate in rivals[:MOST_RIVALS]]

    @property
    def compared(self) -> int:
        """How many come as near to the records' spectra as the first: which is right the records in time must tell."""
        if self.prescribed.is_modal:
            return 1
        first, *others = self.promising
        return 1 + sum(candidate.misfit <= AS_NEAR * first.misfit for candidate in others)

    @cached_property
    def promising(self) -> list[Candidate]:
        """Linear structures, or what was given, to begin with."""
        most, candidates, known, guess = self.most, self._linear, self._known, self._guess
        m, k = (np.where(np.isnan(known[kind]), guess[kind], known[kind]) for kind in ("m", "k"))
        start = Candidate({"m": m, "k": k, "c": np.where(np.isnan(known["c"]), 0.0, known["c"])}, np.inf)
        if most is None:
            candidates = [c for c in candidates[:MOST_RIVALS] if c.misfit <= RIVAL * candidates[0].misfit]
        start = replace(start, calibration=candidates[0].calibration if candidates else {})
        among = candidates[:most]
        if not among:
            return [start if most == 0 else self._by_own_motion(start)]
        if most == 1:
            return among
        own = start if among[0].misfit < MUCH else self._by_own_motion(start)
        said = [self.given.get(p, np.nan) > 0 for p in self.unknown if p.kind in (MASS, "k")]
        wanted = own is not start or (bool(said) and all(said))
        if wanted and all(_are_distinct(own, candidate, self.unknown) for candidate in among):
            return [*candidates[: None if most is None else most - 1], own]
        return among

    @cached_property
    def _known(self) -> dict[str, np.ndarray]:
        return linear_parts(self.prescribed, self.unknown)

    @cached_property
    def _guess(self) -> dict[str, np.ndarray]:
        """Masses (n,) and stiffnesses (C,) with the right ratios, as far as anybody has said something about them."""
        scales = parameter_scales(self.prescribed, self.records)
        out = {}
        for kind in ("m", "k"):
            values = self.prescribed.parameters[kind].detach().cpu().double().numpy().copy()
            for parameter in self.unknown:
                if parameter.kind == kind:
                    said = self.given.get(parameter, np.nan)
                    values[parameter.index] = said if said > 0 else np.nan
            positive = values[np.isfinite(values) & (values > 0)]
            out[kind] = np.where(values > 0, values, np.median(positive) if positive.size else scales[kind])
        return out

    @cached_property
    def _linear(self) -> list[Candidate]:
        """Linear structures that come near to the record."""
        scattered = any(misses_samples(channel, record) for record in self.records for channel in record.calibrated)
        candidates = () if self.most == 0 else islice(self._screening.candidates(), self.most)
        # Where missing samples scatter everything the right one explains a little only.
        return [c for c in candidates if c.misfit < (NEARLY_NOTHING if scattered else HOPELESS)]

    @cached_property
    def _screening(self) -> Screening:
        return Screening(self.prescribed, self.records, self._known, self._guess)

    def _by_own_motion(self, candidate: Candidate) -> Candidate:
        """Of a structure that is no linear one, with the common factor on its unknown springs that its free run tells.

        See :mod:`pinn_cli.scheme.starts`. Where parameters of a law are unknown, the free run says nothing of
        springs.
        """
        prescribed, unknown = self.prescribed, self.unknown
        free = [] if any(p.kind not in LINEAR_UNITS for p in unknown) else [p.index for p in unknown if p.kind == "k"]
        stretch = prescribed.stretch.matrix[prescribed.added].toarray()[:, : prescribed.coordinates]
        factors = common_factors(stretch, candidate.parameters["m"], candidate.parameters["k"], self.records, FREE_RUNS)
        best, least = candidate, np.inf
        for factor in factors[np.abs(np.log10(factors)) <= DECADES_OFF] if free else ():
            k = candidate.parameters["k"].copy()
            k[free] *= factor
            starts = self._at(candidate.parameters | {"k": k})
            structure = prescribed.with_values({parameter: start.value for parameter, start in starts.items()})
            if is_linear(structure):
                break  # it has been compared
            misfit = distance(structure, self.records)
            if misfit < least:
                best, least = replace(candidate, parameters=candidate.parameters | {"k": k}), misfit
        return best

    def _start(self, candidate: Candidate) -> dict[Parameter, Start]:
        """Of every unknown parameter, and of gains and delays that sensors may have."""
        sensors = {
            Parameter(kind, number, label=name): Start(value, abs(value))
            for number, (name, of) in enumerate(candidate.calibration.items())
            for kind, value in of.items()
        }
        return self._at(candidate.parameters) | sensors

    def _at(self, linear: Mapping[str, np.ndarray]) -> dict[Parameter, Start]:
        """Of every unknown parameter of a structure whose linear part is this."""
        prescribed, records, unknown, given = self.prescribed, self.records, self.unknown, self.given
        scales = parameter_scales(prescribed, records)
        size = float(np.median([motion_amplitudes(record)["displacement"] for record in records]))
        out, springs = {}, unit_forces(prescribed, size, 0.0)
        # A start that is decades below the others is poorly told: its own value would be a prior that shuts the truth
        # out. Where there is no spring at all the force tells what one would be like.
        typical = {kind: _median_size(linear[kind], float(np.median(scales[kind]))) for kind in (MASS, "k")}
        usual = np.full(len(linear["k"]), typical["k"])
        if prescribed.is_modal:
            usual = _stiffness_between_ends(prescribed)
            usual = usual[: len(linear["k"])]  # behind them are parts, which have no spring of their own
        stretch = prescribed.incidence.matrix[: len(usual)]
        mass = linear["m"][last_ends(stretch.toarray())]
        damping = STARTING_RATIO * 2.0 * np.sqrt(mass * np.maximum(np.abs(linear["k"]), usual))
        # A damper is compared with the spring beside it, and one without a spring with the force.
        damping = np.where(linear["k"] == 0, np.maximum(damping, np.median(scales["c"])), damping)
        ratio = float(np.clip(linear.get("loss", np.array([2.0 * STARTING_RATIO]))[0] / 2.0, *RATIOS))
        of_whole = of_ratio(ratio, linear["m"], stretch, linear["k"]) if prescribed.is_damped_as_whole else {}
        for parameter in unknown:
            kind, index = parameter.kind, parameter.index
            if kind in of_whole:
                value = given.get(parameter, of_whole[kind])
                out[parameter] = Start(value, max(value, of_whole[kind] * max(STARTING_RATIO / ratio, 1.0)))
                continue
            if kind == FACTOR:  # the matrix is the start: nobody updates a model that is wrong by orders of magnitude
                out[parameter] = Start(given.get(parameter, 1.0), 1.0)
                continue
            of_law: Mapping[str, tuple[float, ...]] = {}
            if kind != MASS:  # what the law of its connection has a say in
                connection = int(prescribed.members[kind][index])
                stiffness = max(abs(float(linear["k"][connection])), typical["k"])
                of_law = prescribed.laws[connection].starts(stiffness, size)
            if kind in of_law:
                value, *sizes = of_law[kind]
                out[parameter] = Start(given.get(parameter, value), *sizes)
            elif kind in (MASS, "k"):
                value = float(linear[kind][index])
                out[parameter] = Start(value, max(abs(value), float(usual[index]) if kind == "k" else typical[MASS]))
            elif kind == "c":
                value = given.get(parameter, float(linear["c"][index]))
                out[parameter] = Start(value, max(abs(value), float(damping[index])))
            else:
                value = given.get(parameter, 0.0)  # without it the connection is one like any other
                # A spring as strong as the linear one beside it, at the motion that there is.
                stiffness = max(float(abs(linear["k"][connection])), float(usual[connection]))
                per_unit = springs[kind][index]
                scale = stiffness * size / per_unit if per_unit > 0 else float(scales[kind][index])
                out[parameter] = Start(value, max(abs(value), scale))
        return out


def _are_distinct(first: Candidate, second: Candidate, unknown: Collection[Parameter]) -> bool:
    """Whether two starts are two."""
    places = [(p.kind, p.index) for p in unknown if p.kind in (MASS, "k")]
    return any(abs(np.log(first.parameters[k][i] / second.parameters[k][i])) > SAME_START for k, i in places)


def linear_parts(prescribed: Structure, unknown: Collection[Parameter]) -> dict[str, np.ndarray]:
    """What is known: ``m`` to (n,), ``c`` and ``k`` to (C,), ``loss`` to (1,), NaN where unknown.

    Behind the ``k`` are the factors of parts of a finite-element model, which have no damper.
    """
    given = prescribed.parameters_like(np.empty(0))
    for parameter in unknown:
        if parameter.kind in (*LINEAR_UNITS, FACTOR):
            given[parameter.kind][parameter.index] = np.nan
    parts, _ = prescribed.carriers.get(FACTOR, (np.empty(0), None))
    known = {
        MASS: given[MASS],
        "c": np.append(given["c"], np.zeros(len(parts))),
        "k": np.append(given["k"], given.get(FACTOR, np.empty(0))),
    }
    return known | {"loss": np.array([np.nan if prescribed.is_damped_as_whole else 0.0])}


def _of_modes(
    prescribed: Structure, unknown: Collection[Parameter], given: Mapping[Parameter, float]
) -> dict[str, np.ndarray]:
    """The linear part of a structure in modal coordinates: its modes are those of its matrices."""
    linear = {kind: prescribed.parameters[kind].detach().cpu().double().numpy().copy() for kind in LINEAR_UNITS}
    modes, stiffness = prescribed.groups[0].incidence.shape[0], _stiffness_between_ends(prescribed)
    for parameter in unknown:
        if parameter.kind == "k" and parameter.index >= modes:
            linear["k"][parameter.index] = given.get(parameter, stiffness[parameter.index])
        elif parameter.kind == "c":
            linear["c"][parameter.index] = 0.0
    return linear


def _stiffness_between_ends(prescribed: Structure) -> np.ndarray:
    """(C,), what every connection of modes feels between its ends, N/m: one over the modes' flexibility."""
    stretch = prescribed.incidence.matrix.toarray()
    k = prescribed.parameters["k"].detach().cpu().double().numpy()[: prescribed.coordinates]
    held = np.where(k > 0, k, np.median(k[k > 0]) if (k > 0).any() else 1.0)
    stiffness: np.ndarray = 1.0 / (stretch**2 @ (1.0 / held))
    return stiffness


def _median_size(values: np.ndarray, otherwise: float) -> float:
    """Of those that are not zero."""
    sizes = np.abs(values[values != 0])
    return float(np.median(sizes)) if sizes.size else otherwise


def distance(structure: Structure, records: Sequence[Record]) -> float:
    """Root mean square of the logarithms of power over measured power, of all sensors in the records' bands.

    They are weighed as the sensors stand out of their noise. Infinity where the structure has no free run under one of
    the records.
    """
    squares = []
    for record in records:
        part = affordable(structure, record)
        try:
            motion = free_run(structure, part)
        except NoFreeRunError:
            return np.inf
        sensors = channels(part)
        measured, moved = (
            CrossSpectra.of_bands(part, shown, [], lines_in_band(part))
            for shown in (sensors, [replace(sensor, measured=sensor.of(motion)) for sensor in sensors])
        )
        kernel = measured.smoothing(WIDTHS[0])
        power, floor = np.maximum(kernel @ measured.power, 1e-300), ABOVE_FLOOR * measured.floor
        logarithms = power / (power + floor) * np.log((kernel @ moved.power + floor) / power)
        squares.append(logarithms.reshape(-1) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))
