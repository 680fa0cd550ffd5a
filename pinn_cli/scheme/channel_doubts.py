"""Gains and delays that are in doubt, in the frequency domain: a factor on the spectrum of every channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.channels import Channel
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.gauge import DELAYS_ALLOWED, WIDEST_DELAY
from pinn_cli.record.record import Record
from pinn_cli.system.quantities import SUPPORT

# Delays that are tried within one period of the highest frequency.
PER_PERIOD = 8


@dataclass(frozen=True)
class Doubt:
    """One number of one sensor, whichever records it is in.

    Attributes:
        kind: ``gain`` or ``delay``.
        sensor: Its name.
        believed: The number before the record is looked at.
        std: Of a delay, s.
    """

    kind: str
    sensor: str
    believed: float
    std: float = 0.0


def doubts_of(records: Sequence[Record]) -> list[Doubt]:
    """Gains and delays that are not known, of gauges in a column of a DOF; of those of one name the first one's."""
    found: dict[tuple[str, str], Doubt] = {}
    for record in records:
        for gauge in (gauge for gauge in record.gauges if gauge.dof is not None and gauge.quantity not in SUPPORT):
            for kind, number in (("gain", gauge.of("gain")), ("delay", gauge.of("delay"))):
                if not number.is_known:
                    found.setdefault((kind, gauge.name), Doubt(kind, gauge.name, number.value, number.std))
    return list(found.values())


def doubts_about(channel: Channel, step: float) -> list[Doubt]:
    """A gain and a delay of a channel with samples so far apart (s), whatever is said of it."""
    return [Doubt("gain", channel.name, 1.0), Doubt("delay", channel.name, 0.0, WIDEST_DELAY * step)]


class ChannelDoubts:
    """What every channel shows of what it feels, exp(gain - i omega delay), where that is in doubt.

    The unknowns are the logarithms of gains, and delays in their prior standard deviations; both are 0 where the record
    was believed to be calibrated.

    Args:
        record: What was measured.
        spectra: Of it.
        doubts: Those of other records' sensors among them.
    """

    def __init__(self, record: Record, spectra: CrossSpectra[Channel], doubts: Sequence[Doubt]) -> None:
        self.omega, self.sensors, self.doubts = spectra.omega, len(spectra.sensors), tuple(doubts)
        channels = [*spectra.sensors, *spectra.acting]
        self.count = len(channels)
        places: Mapping[tuple[str, int | None], int] = {channel.place: i for i, channel in enumerate(channels)}
        of = {channel.name: i for i, channel in enumerate(channels)}
        of |= {g.name: places[g.quantity, g.dof] for g in record.gauges if (g.quantity, g.dof) in places}
        # Of every doubt the channel, of the sensors and then of what acts; None: it is in other records.
        self.channels = [of.get(doubt.sensor) for doubt in doubts]

    def __len__(self) -> int:
        return len(self.doubts)

    @property
    def doubtful(self) -> list[int]:
        """Channels of which anything is in doubt: what acts before what was sensed."""
        return sorted({c for c in self.channels if c is not None}, key=lambda c: (c < self.sensors, c))

    def factors(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(B, S) of the sensors and (B, F) of what acts, what is shown over what is felt."""
        log = np.zeros((len(self.omega), self.count), complex)
        for value, doubt, channel in zip(y, self.doubts, self.channels, strict=True):
            if channel is not None:
                log[:, channel] += value * self._slope(doubt)
        every = np.exp(log)
        return every[:, : self.sensors], every[:, self.sensors :]

    def slopes(self, parts: np.ndarray) -> list[np.ndarray]:
        """(B, S, F), of the cross spectra by every unknown; (F, B, S, F) are what each input makes of them."""
        out, cross = [], parts.sum(0)
        for doubt, channel in zip(self.doubts, self.channels, strict=True):
            by, slope = np.zeros_like(cross), self._slope(doubt).reshape(-1, 1, 1)
            if channel is not None and channel < self.sensors:
                by[:, channel] = (slope * cross)[:, channel]
            elif channel is not None:
                by = -slope * parts[channel - self.sensors]
            out.append(by)
        return out

    def _slope(self, doubt: Doubt) -> np.ndarray:
        return np.ones(len(self.omega)) + 0j if doubt.kind == "gain" else -1j * self.omega * doubt.std

    def places(self, channel: int) -> dict[str, int]:
        """Kind to the place of a channel's doubts among the unknowns."""
        return {self.doubts[i].kind: i for i, own in enumerate(self.channels) if own == channel}

    def tried_delays(self, doubt: Doubt) -> np.ndarray:
        """(D,), in prior standard deviations, close enough to meet every valley."""
        step = 2.0 * np.pi / (PER_PERIOD * self.omega[-1] * doubt.std)
        return np.linspace(-DELAYS_ALLOWED, DELAYS_ALLOWED, 2 * int(np.ceil(DELAYS_ALLOWED / step)) + 1)

    def calibration(self, y: np.ndarray) -> dict[str, dict[str, float]]:
        """Name of a sensor to the gain and delay (s) that the unknowns say."""
        out: dict[str, dict[str, float]] = {}
        for value, doubt in zip(y, self.doubts, strict=True):
            found = doubt.believed * np.exp(value) if doubt.kind == "gain" else doubt.believed + value * doubt.std
            out.setdefault(doubt.sensor, {})[doubt.kind] = float(found)
        return out
