"""What a sensor's samples say of its noise by themselves, before anything is estimated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pinn_cli.record.channels import FINEST_KNOWN
from pinn_cli.record.gauge import Gauge
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import FAR_BELOW, level_at_end, lowest_level, visible_floor

# Where a sensor's noise starts that no spectrum shows, over the spread of its channel, unless the emptiest part of its
# spectrum has less.
FIRST_SENSOR = 0.1


@dataclass(frozen=True, eq=False)
class SensorSamples:
    """The samples of one sensor.

    Attributes:
        quantity: What it measures.
        dof: The channel of its quantity that it fills, counted from 0; None: it fills none.
        values: (J,), SI units.
        run: Samples in a row (R,) whose times are even, and the step, s; None: none are many enough to show its noise.
        record: That it belongs to.
        scatter: Its noise as repeated measurements tell it; None: they do not.
    """

    quantity: str
    dof: int | None
    values: np.ndarray
    run: tuple[np.ndarray, float] | None
    record: Record
    scatter: float | None = None

    @classmethod
    def of_column(cls, record: Record, quantity: str, dof: int) -> SensorSamples:
        """Of a column of the record."""
        values, repeats = record.histories(quantity)[:, dof], record.repeats
        scatter = None if repeats is None else float(repeats.noise_of_mean(quantity)[dof])
        return cls(quantity, dof, values, (values, record.step), record, scatter)

    @classmethod
    def of_gauge(cls, gauge: Gauge, record: Record) -> SensorSamples:
        """Of a channel with samples of its own."""
        return cls(gauge.quantity, gauge.dof, gauge.values, gauge.even_run, record)

    @cached_property
    def rms(self) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(self.values**2)))

    @cached_property
    def spread(self) -> float:
        """Standard deviation; of one value throughout, its size."""
        return float(np.std(self.values)) or self.rms

    @property
    def finest(self) -> float:
        """The least noise that any sensor of such a signal has."""
        return FINEST_KNOWN * self.spread

    @cached_property
    def shown(self) -> float:
        """Noise that its spectrum shows above its band; 0 where it shows none.

        Content that is even up to 0.8 of the Nyquist frequency and ends above it passes for noise there, unless no
        filter of the record can have emptied what lies beyond.
        """
        if self.run is None:
            return 0.0
        visible, at_end = visible_floor(*self.run) or 0.0, level_at_end(*self.run)
        if at_end is None or at_end**2 > FAR_BELOW * visible**2 or self.record.is_filtered:
            return visible
        return at_end

    @cached_property
    def most(self) -> float:
        """Noise that it has at most: what the emptiest part of its spectrum has."""
        return np.inf if self.run is None else lowest_level(*self.run)

    @property
    def first(self) -> float:
        """Where its noise starts: what shows above its band, if anything does; the scatter of repeats tells it."""
        level = self.shown or min(FIRST_SENSOR * self.spread, self.most)
        return max(level if self.scatter is None else self.scatter, self.finest)


def starting_levels(record: Record, quantity: str) -> np.ndarray:
    """(channels,), where the noise of the columns of a quantity starts; NaN where there is no sensor."""
    there = record.sensors(quantity)
    levels = np.full(len(there), np.nan)
    for dof in np.flatnonzero(there):
        levels[dof] = SensorSamples.of_column(record, quantity, int(dof)).first
    return levels
