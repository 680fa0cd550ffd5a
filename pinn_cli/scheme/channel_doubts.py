"""Gains and delays that are in doubt, in the frequency domain: a factor on the spectrum of every channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinn_cli.record.channels import Channel
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.gauge import DELAYS_ALLOWED, WIDEST_DELAY
from pinn_cli.record.record import Record

# Delays that are tried within one period of the highest frequency.
PER_PERIOD = 8


@dataclass(frozen=True)
class Doubt:
    """One number of one channel.

    Attributes:
        kind: ``gain`` or ``delay``.
        gauge: Name of the gauge.
        channel: Of the sensors, then of what acts.
        believed: The number before the record is looked at.
        std: Of a delay, s.
    """

    kind: str
    gauge: str
    channel: int
    believed: float
    std: float = 0.0


class ChannelDoubts:
    """What every channel shows of what it feels, exp(gain - i omega delay), where that is in doubt.

    The unknowns are the logarithms of gains, and delays in their prior standard deviations; both are 0 where the record
    was believed to be calibrated.

    Args:
        record: What was measured.
        spectra: Of it.
        doubted: A channel whose gain and delay are in doubt, whatever is said of it.
    """

    def __init__(self, record: Record, spectra: CrossSpectra[Channel], doubted: Channel | None = None) -> None:
        self.omega, self.sensors = spectra.omega, len(spectra.sensors)
        channels: list[tuple[str, int | None]] = [channel.place for channel in (*spectra.sensors, *spectra.acting)]
        self.count = len(channels)
        self.doubts = tuple(
            Doubt(kind, gauge.name, channels.index((gauge.quantity, gauge.dof)), number.value, number.std)
            for gauge in record.gauges
            if (gauge.quantity, gauge.dof) in channels
            for kind, number in (("gain", gauge.of("gain")), ("delay", gauge.of("delay")))
            if not number.is_known
        )
        if doubted is not None:
            place = channels.index(doubted.place)
            late = WIDEST_DELAY * record.step
            self.doubts += (Doubt("gain", doubted.name, place, 1.0), Doubt("delay", doubted.name, place, 0.0, late))

    def __len__(self) -> int:
        return len(self.doubts)

    @property
    def doubtful(self) -> list[int]:
        """Channels of which anything is in doubt: what acts before what was sensed."""
        return sorted({doubt.channel for doubt in self.doubts}, key=lambda c: (c < self.sensors, c))

    def factors(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(B, S) of the sensors and (B, F) of what acts, what is shown over what is felt."""
        log = np.zeros((len(self.omega), self.count), complex)
        for value, doubt in zip(y, self.doubts, strict=True):
            log[:, doubt.channel] += value * self._slope(doubt)
        every = np.exp(log)
        return every[:, : self.sensors], every[:, self.sensors :]

    def slopes(self, cross: np.ndarray, driven: np.ndarray) -> list[np.ndarray]:
        """Derivatives (B, S, F) of the cross spectra by every unknown.

        Args:
            cross: (B, S, F), the cross spectra.
            driven: (F, B, S, F), the part of them that each force makes.
        """
        out = []
        for doubt in self.doubts:
            slope = self._slope(doubt).reshape(-1, 1, 1)
            if doubt.channel < self.sensors:
                by = np.zeros_like(cross)
                by[:, doubt.channel] = (slope * cross)[:, doubt.channel]
            else:
                by = -slope * driven[doubt.channel - self.sensors]
            out.append(by)
        return out

    def _slope(self, doubt: Doubt) -> np.ndarray:
        return np.ones(len(self.omega)) + 0j if doubt.kind == "gain" else -1j * self.omega * doubt.std

    def places(self, channel: int) -> dict[str, int]:
        """Kind to the place of a channel's doubts among the unknowns."""
        return {doubt.kind: i for i, doubt in enumerate(self.doubts) if doubt.channel == channel}

    def tried_delays(self, doubt: Doubt) -> np.ndarray:
        """(D,), in prior standard deviations, close enough to meet every valley."""
        step = 2.0 * np.pi / (PER_PERIOD * self.omega[-1] * doubt.std)
        return np.linspace(-DELAYS_ALLOWED, DELAYS_ALLOWED, 2 * int(np.ceil(DELAYS_ALLOWED / step)) + 1)

    def calibration(self, y: np.ndarray) -> dict[str, dict[str, float]]:
        """Name of a gauge to the gain and delay (s) that the unknowns say."""
        out: dict[str, dict[str, float]] = {}
        for value, doubt in zip(y, self.doubts, strict=True):
            found = doubt.believed * np.exp(value) if doubt.kind == "gain" else doubt.believed + value * doubt.std
            out.setdefault(doubt.gauge, {})[doubt.kind] = float(found)
        return out
