"""Columns of a record as they are inspected: their samples on a regular clock, and what they are.

Where nobody has said what a column measures, its unit and its name do.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.channel import named
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.files.table import bare
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.record.spectrum import decimate, signal_band
from pinn_cli.record.units import si_factor
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import FORCE, GROUND, INPUTS, MOTION, UNITS

# Times off the regular axis by more than this part of a step are put onto it.
OFF_REGULAR = 0.05
# A record keeps this many times the highest frequency of its content, and so many samples.
OVERSAMPLED, FEWEST_KEPT = 4.0, 256
ACCELERATION = MOTION[2]
# What is measured in a unit.
_LENGTH = r"(?:[munkc]?m|in|ft|mil)"
_UNITS = (
    (ACCELERATION, re.compile(rf"[mu]?g|g_?n|m?[Gg]al|{_LENGTH}\s*(?:/\s*s\s*(?:\^?2|\*\*2|/\s*s)|\s\^?s\^?-2)")),
    ("velocity", re.compile(rf"{_LENGTH}\s*/\s*s")),
    ("displacement", re.compile(_LENGTH)),
    (FORCE, re.compile(r"[mkM]?N|lbf?|kip|kgf")),
)
# What columns are called.
_NAMES = (
    (GROUND, re.compile(r"ground|base|table|\bag\b|ugdd|boden|fundament", re.IGNORECASE)),
    (FORCE, re.compile(r"^(f|p)\W*\d*\b|^f[a-z]?\d|forc|load|hammer|shaker|kraft", re.IGNORECASE)),
    (ACCELERATION, re.compile(r"^a\W*\d*\b|^a[a-z]?\d|acc|beschl|udd", re.IGNORECASE)),
    ("velocity", re.compile(r"^v\W*\d*\b|^v[a-z]?\d|vel|geschw", re.IGNORECASE)),
    ("displacement", re.compile(r"^(u|d|x|y)\W*\d*\b|^[ud][a-z]?\d|disp|lvdt|laser|weg|verschieb", re.IGNORECASE)),
)
# What is numbered as channels are, not as DOFs.
_CHANNELS = re.compile(r"(^|[\W_])(ch|chan|channel|kanal|ai|input|sensor)\W*#", re.IGNORECASE)
# A number beyond this is that of a channel or a node.
_MOST_DOFS = 50


@dataclass(frozen=True, eq=False)
class Signal:
    """One column.

    Attributes:
        column: Its name in the file.
        values: (N,), in ``unit``; NaN where a cell is empty.
        quantity: displacement, velocity, acceleration, force or ground_acceleration; "": nobody has said.
        place: Number or name of the DOF or support; "" of the ground, and where nobody has said.
        unit: "": nobody has said; where it is known what is measured, SI.
    """

    column: str
    values: np.ndarray
    quantity: str = ""
    place: str = ""
    unit: str = ""

    @property
    def name(self) -> str:
        """As sentences have it: ``acceleration of DOF 3``; else the column in quotes."""
        return named(self.quantity, self.place) if self.quantity else repr(self.column)

    @property
    def is_input(self) -> bool:
        """Whether it is what acts."""
        return self.quantity in INPUTS

    @property
    def there(self) -> np.ndarray:
        """(J,), the samples that are not missing."""
        return self.values[np.isfinite(self.values)]

    @property
    def varies(self) -> bool:
        """Whether there are numbers enough, and not all the same."""
        return len(self.there) >= MINIMUM_SAMPLES and bool(np.ptp(self.there) > 0.0)

    @property
    def order(self) -> int:
        """How often the displacement is differentiated; a sensor of which nobody has said anything counts as others."""
        return MOTION.index(self.quantity) if self.quantity in MOTION else 2

    @property
    def shown_unit(self) -> str:
        """Its own, else that of the quantity, which is taken for granted."""
        return self.unit or UNITS.get(self.quantity, "")

    def in_si(self) -> tuple[Signal, str]:
        """The same in SI units, and a sentence where its unit is none of its quantity's."""
        if not self.unit or self.quantity not in UNITS:
            return self, ""
        plain = UNITS[self.quantity]
        try:
            factor = si_factor(f"unit of {self.column}", self.unit, self.quantity)
        except InputError:
            says = f"the file says that {self.name} is in {self.unit}, which is no unit of it"
            how = f"unit: 1 in the command below takes one {self.unit} for one {plain}"
            return replace(self, unit=plain), f"{says}: {how}; or say how many (data.channels.{self.column}.unit)"
        return replace(self, values=factor * self.values if factor != 1.0 else self.values, unit=plain), ""


@dataclass(frozen=True, eq=False)
class Sampling:
    """When the samples of a record were taken.

    Attributes:
        time: (N,), s, increasing.

    Raises:
        InputError: There are too few.
    """

    time: np.ndarray

    def __post_init__(self) -> None:
        if len(self.time) < MINIMUM_SAMPLES:
            allowed = f"a record of at least {MINIMUM_SAMPLES} samples"
            raise InputError("data.start, data.stop", f"{len(self.time)} samples", allowed)

    @property
    def step(self) -> float:
        """The usual step, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def rate(self) -> float:
        """Hz, from all steps but the holes: their mean has more digits than one of them is printed with."""
        steps = np.diff(self.time)
        return 1.0 / float(np.mean(steps[steps <= 1.5 * self.step]))

    @property
    def duration(self) -> float:
        """S."""
        return float(self.time[-1] - self.time[0])

    @property
    def holes(self) -> list[tuple[float, float]]:
        """Times before and after every step that is longer than one and a half usual ones, s."""
        after = np.flatnonzero(np.diff(self.time) > 1.5 * self.step)
        return [(float(self.time[i]), float(self.time[i + 1])) for i in after]

    @property
    def jitter_percent(self) -> float:
        """Root mean square deviation of the steps from the usual one, holes left out, % of it."""
        steps = np.diff(self.time)
        steps = steps[steps <= 1.5 * self.step]
        return float(100.0 * np.sqrt(np.mean((steps / self.step - 1.0) ** 2)))

    @property
    def regular(self) -> np.ndarray:
        """(M,), s: from the first sample to the last at the usual rate; the times themselves, where they are even."""
        count = round(self.duration * self.rate) + 1
        axis = self.time[0] + np.arange(count) / self.rate
        even = count == len(self.time) and np.max(np.abs(axis - self.time)) <= OFF_REGULAR * self.step
        return self.time if even else axis

    def on_regular(self, values: np.ndarray) -> np.ndarray:
        """Samples (N,), of which one at least is there, at `regular`, (M,); straight lines over what is missing."""
        there, axis = np.isfinite(values), self.regular
        if axis is self.time and there.all():
            return values
        return np.interp(axis, self.time[there], values[there])


def spectra_of(signals: Sequence[Signal], sampling: Sampling, highest: float | None = None) -> CrossSpectra[Signal]:
    """Of columns that vary, after decimation to their band; those of which nobody has said anything count as sensors.

    The highest frequency of any channel's content, Hz, is looked for unless it is given.
    """
    sensors = [signal for signal in signals if not signal.is_input]
    acting = [signal for signal in signals if signal.is_input]
    values = np.stack([sampling.on_regular(signal.values) for signal in (*sensors, *acting)], axis=1)
    values, step = values - values.mean(axis=0), 1.0 / sampling.rate
    if highest is None:
        highest = max(signal_band(column, step) for column in values.T)
    factor = max(1, int(1.0 / (step * OVERSAMPLED * highest))) if highest > 0.0 else 1
    factor = min(factor, max(1, len(values) // FEWEST_KEPT))
    return CrossSpectra.of_pieces(sensors, acting, decimate(values, factor), step * factor)


def guessed(signals: Sequence[Signal]) -> tuple[list[Signal], list[str]]:
    """The same with quantity and DOF, and what is to be said of that; both empty where somebody has said what one is.

    A unit goes before a name. Where neither says anything, all columns are taken for accelerations. DOFs are the
    numbers in the names, unless these are numbers of channels: then the columns of a quantity are counted.
    """
    if any(signal.quantity for signal in signals):
        return [], []
    notes = ["what columns are is guessed by their names and units: see the command below"]
    quantities = [_quantity(signal) for signal in signals]
    if not any(quantity in MOTION for quantity in quantities):
        unknown = [i for i, quantity in enumerate(quantities) if not quantity]
        for i in unknown:
            quantities[i] = ACCELERATION
        if unknown:
            notes = ["nothing says what the columns measure: they are taken for accelerations in m/s^2"]
    numbers = [number_of(signal) for signal in signals]
    stems = defaultdict[str, set[str]](set)
    for signal, quantity in zip(signals, quantities, strict=True):
        stems[re.sub(r"\d+", "#", bare(signal.column))].add(quantity)
    channels = any(len(of_stem - {""}) > 1 or _CHANNELS.search(stem) for stem, of_stem in stems.items())
    places, counted = [""] * len(signals), False
    for quantity in (*MOTION, FORCE):
        indices = [i for i, other in enumerate(quantities) if other == quantity]
        named = [numbers[i] for i in indices]
        no_dofs = any(number is not None and not 1 <= number <= _MOST_DOFS for number in named)
        if channels or len(set(named)) < len(named) or (None in named and len(named) > 1) or no_dofs:
            named, counted = list(range(1, len(indices) + 1)), counted or len(indices) > 1
        for i, number in zip(indices, named, strict=True):
            places[i] = str(number or 1)
    if counted:
        notes.append("which DOF a column belongs to is not in its name: they are counted as they stand in the file")
    guesses = zip(signals, quantities, places, strict=True)
    return [replace(signal, quantity=quantity, place=place) for signal, quantity, place in guesses], notes


def quantity_of_unit(unit: str) -> str:
    """What is measured in a unit; "": nothing that is known here."""
    return next((quantity for quantity, pattern in _UNITS if pattern.fullmatch(unit)), "")


def _quantity(signal: Signal) -> str:
    of_unit = quantity_of_unit(signal.unit)
    parts = [signal.column, *reversed(re.split(r"[/.]", signal.column))]
    of_name = next((quantity for part in parts for quantity, name in _NAMES if name.search(part.strip())), "")
    return GROUND if of_name == GROUND and of_unit in ("", ACCELERATION) else of_unit or of_name


def number_in(column: str) -> int | None:
    """In the name of a column, that of its last part that has one."""
    parts = reversed(re.split(r"[/.]", bare(column)))
    digits = next((match for part in parts if (match := re.search(r"\d+", part))), None)
    return None if digits is None else int(digits[0])


def number_of(signal: Signal) -> int | None:
    """That of the place, else that in the name."""
    match = re.search(r"\d+", signal.place)
    return number_in(signal.column) if match is None else int(match[0])
