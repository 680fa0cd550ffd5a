"""What is in doubt about the sensors: parameters like those of the structure, whatever the scheme.

Gains and delays that are in doubt, in the frequency domain: a factor on the spectrum of every channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.record.channel import DELAYS_ALLOWED, WIDEST_DELAY, Channel
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS, FORCE, HIGH_PASS, OF_ONE_CHANNEL, UNITS

# Delays that are tried within one period of the highest frequency.
PER_PERIOD = 8


def sensor_parameters(record: Record) -> tuple[Parameter, ...]:
    """The calibrations that are not known, of every channel of a record.

    Raises:
        InputError: No gain is known. Motions, forces and the noise found can then all be larger or smaller together.
    """
    plain = any(record.plain(quantity).any() for quantity in (*record.response_quantities, FORCE))
    if record.calibrated and not plain and not any(channel.number("gain").is_known for channel in record.calibrated):
        allowed = "one channel at least whose gain is a number: the reference"
        hint = "with every gain in doubt nothing tells how large motions and forces are"
        raise InputError("data.channels", "gain in doubt on all", allowed, hint)
    return tuple(
        Parameter(
            kind,
            channel.index,
            prescribed=number.value,
            prior_std=number.std,
            unknown=number.unknown,
            unit=UNITS[channel.quantity] + unit if kind in OF_ONE_CHANNEL else unit,
            positive=kind == HIGH_PASS,
            label=channel.key,
        )
        for channel in record.calibrated
        for kind, unit in CALIBRATION_UNITS.items()
        if not (number := channel.number(kind)).is_known
    )


def calibrations(channels: Sequence[Channel]) -> dict[str, Tensor]:
    """Kind to the numbers of channels as they are known or believed, (channels,); none without channels."""
    if not channels:
        return {}
    values = {kind: [channel.number(kind).value for channel in channels] for kind in CALIBRATION_UNITS}
    return {kind: torch.tensor(of_kind, dtype=torch.float64) for kind, of_kind in values.items()}


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
    """Gains and delays that are not known, of channels in a column of a DOF; of those of one name the first one's."""
    doubts: dict[tuple[str, str], Doubt] = {}
    for record in records:
        for channel in (channel for channel in record.calibrated if channel.is_column):
            for kind in ("gain", "delay"):
                if not (number := channel.number(kind)).is_known:
                    doubts.setdefault((kind, channel.key), Doubt(kind, channel.key, number.value, number.std))
    return list(doubts.values())


def doubts_about(channel: Channel, step: float) -> list[Doubt]:
    """A gain and a delay of a channel with samples so far apart (s), whatever is said of it."""
    return [Doubt("gain", channel.name, 1.0), Doubt("delay", channel.name, 0.0, WIDEST_DELAY * step)]


class ChannelDoubts:
    """What every channel shows of what it feels, exp(gain - i omega delay), where that is in doubt.

    The unknowns are the logarithms of gains, and delays in their prior standard deviations; both are 0 where the record
    was believed to be calibrated. Doubts about other records' sensors may be among them.
    """

    def __init__(self, record: Record, spectra: CrossSpectra[Channel], doubts: Sequence[Doubt]) -> None:
        self.omega, self.sensors, self.doubts = spectra.omega, len(spectra.sensors), tuple(doubts)
        channels = [*spectra.sensors, *spectra.acting]
        self.count = len(channels)
        places = {channel.place: i for i, channel in enumerate(channels)}
        of = {channel.name: i for i, channel in enumerate(channels)}
        of |= {channel.key: places[channel.place] for channel in record.calibrated if channel.place in places}
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
        factors = np.exp(log)
        return factors[:, : self.sensors], factors[:, self.sensors :]

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
        return {self.doubts[i].kind: i for i, number in enumerate(self.channels) if number == channel}

    def tried_delays(self, doubt: Doubt) -> np.ndarray:
        """(D,), in prior standard deviations, close enough to meet every valley."""
        step = 2.0 * np.pi / (PER_PERIOD * self.omega[-1] * doubt.std)
        return np.linspace(-DELAYS_ALLOWED, DELAYS_ALLOWED, 2 * int(np.ceil(DELAYS_ALLOWED / step)) + 1)

    def calibration(self, y: np.ndarray) -> dict[str, dict[str, float]]:
        """Name of a sensor to the gain and delay (s) that the unknowns say."""
        out: dict[str, dict[str, float]] = {}
        for value, doubt in zip(y, self.doubts, strict=True):
            number = doubt.believed * np.exp(value) if doubt.kind == "gain" else doubt.believed + value * doubt.std
            out.setdefault(doubt.sensor, {})[doubt.kind] = float(number)
        return out
