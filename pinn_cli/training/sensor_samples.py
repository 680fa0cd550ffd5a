"""What a sensor's samples say of its noise by themselves, before anything is estimated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import FINEST_KNOWN
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import FAR_BELOW, level_at_end, lowest_level, visible_floor

# Where a sensor's noise starts that no spectrum shows, over the spread of its channel, unless the emptiest part of its
# spectrum has less.
FIRST_SENSOR = 0.1
# Times that the sensor of an input may be as noisy as its spectrum shows: what is more lies in the band of the input
# alone, and is none of its noise. A force that is missing there would pass for it, and the model for right.
LOUDEST = 1.5


@dataclass(frozen=True, eq=False)
class SensorSamples:
    """The samples of one channel.

    Attributes:
        channel: Whose.
        record: That it belongs to.
        quietest: Noise that a solution leaves of it in the quietest part of its band.
    """

    channel: Channel
    record: Record
    quietest: float = np.inf

    @property
    def scatter(self) -> float | None:
        """Its noise as repeated measurements tell it; None: they do not."""
        quantity, number = self.channel.place
        repeats = self.record.repeats if self.channel.is_column else None
        return None if repeats is None else float(repeats.noise_of_mean(quantity)[number])

    @cached_property
    def run(self) -> tuple[np.ndarray, float] | None:
        """See :attr:`Channel.even_run`."""
        return self.channel.even_run

    @cached_property
    def rms(self) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(self.channel.measured**2)))

    @cached_property
    def spread(self) -> float:
        """Standard deviation; of one value throughout, its size."""
        return float(np.std(self.channel.measured)) or self.rms

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
    def loudest(self) -> float:
        """Noise that it may be found to have where it measures an input."""
        return LOUDEST * min(self.shown or self.most, self.quietest)

    @property
    def first(self) -> float:
        """Where its noise starts: what shows above its band, if anything does; the scatter of repeats tells it."""
        level = self.shown or min(FIRST_SENSOR * self.spread, self.most)
        return max(level if self.scatter is None else self.scatter, self.finest)


def starting_levels(record: Record, quantity: str) -> np.ndarray:
    """(channels,), where the noise of the columns of a quantity starts; NaN where there is no sensor."""
    present = record.sensors(quantity)
    levels = np.full(len(present), np.nan)
    for dof in np.flatnonzero(present):
        levels[dof] = SensorSamples(record.column(quantity, int(dof)), record).first
    return levels
