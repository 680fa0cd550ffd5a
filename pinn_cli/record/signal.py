"""Columns of a record as they are inspected, and their samples on a regular clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.channels import named
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.record.response import GROUND, UNITS
from pinn_cli.record.spectrum import decimate, signal_band
from pinn_cli.record.units import si_factor
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import MOTION, SUPPORT

# Times off the regular axis by more than this part of a step are put onto it.
EVEN = 0.05
# What acts on a structure.
INPUTS = ("force", GROUND, *SUPPORT)
# A record keeps this many times the highest frequency of its content, and so many samples.
OVERSAMPLED, FEWEST_SAMPLES = 4.0, 256


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
    def varies(self) -> bool:
        """Whether there are numbers enough, and not all the same."""
        there = self.values[np.isfinite(self.values)]
        return len(there) >= MINIMUM_SAMPLES and bool(np.ptp(there) > 0.0)

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
    """

    time: np.ndarray

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
        even = count == len(self.time) and np.max(np.abs(axis - self.time)) <= EVEN * self.step
        return self.time if even else axis

    def on_regular(self, values: np.ndarray) -> np.ndarray:
        """Samples (N,) at `regular`, (M,); straight lines over what is missing.

        Raises:
            ValueError: There are none.
        """
        there = np.isfinite(values)
        if not there.any():
            raise ValueError("a column without a number")
        axis = self.regular
        if axis is self.time and there.all():
            return values
        return np.interp(axis, self.time[there], values[there])


def spectra_of(signals: Sequence[Signal], sampling: Sampling, highest: float | None = None) -> CrossSpectra[Signal]:
    """Of a record's columns after decimation to its band; those of which nobody has said anything count as sensors.

    Args:
        signals: With numbers that vary.
        sampling: Of their values.
        highest: Frequency of any channel's content, Hz; None: it is looked for.
    """
    sensors = [signal for signal in signals if not signal.is_input]
    acting = [signal for signal in signals if signal.is_input]
    values = np.stack([sampling.on_regular(signal.values) for signal in (*sensors, *acting)], axis=1)
    values, step = values - values.mean(axis=0), 1.0 / sampling.rate
    if highest is None:
        highest = max(signal_band(column, step) for column in values.T)
    factor = max(1, int(1.0 / (step * OVERSAMPLED * highest))) if highest > 0.0 else 1
    factor = min(factor, max(1, len(values) // FEWEST_SAMPLES))
    return CrossSpectra.of_pieces(sensors, acting, decimate(values, factor), step * factor)
