"""The channels of a record, one sensor each: their band, how large the motion is, what a sensor has not followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.gauge import Gauge
from pinn_cli.record.record import Record
from pinn_cli.record.response import MEASURED_QUANTITIES, QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.record.spectrum import LOWEST_BINS, USABLE_NYQUIST_FRACTION, periodogram, signal_band, visible_floor
from pinn_cli.system.quantities import GROUND, SUPPORT

# Part of a channel's spread, or of whatever else is estimated, to which it is known at best: below it rounding and the
# splines' own error rule.
FINEST_KNOWN = 1e-6
# The DOF of the ground's channel, counted from 0; a reader, who counts from 1, sees it as 0.
GROUND_DOF = -1
# Equal samples in a row that noise and a converter's steps do not explain; and samples at an extreme value that may be
# there by chance.
CONSTANT_RUN, AT_EXTREME_BY_CHANCE = 8, 2
# Of the mains, Hz. A sine of such a frequency has one phase in all parts of a record, which a mode has by chance alone:
# the statistic of so many parts is F-distributed, and beyond `STEADY_LINE` once in 10^7 times. It is told from such a
# part of the channel's power on; and what acts has a line of its own from `FAINT` on.
MAINS, LINE_PARTS, STEADY_LINE, FAINT, LEAST_HUM = (50.0, 60.0), 8, 50.0, 10.0, 0.05


@dataclass(frozen=True, eq=False)
class Channel:
    """One sensor and what it measured.

    Attributes:
        quantity: displacement, velocity, acceleration, force, ground_acceleration, or that of a support.
        dof: Counted from 0; `GROUND_DOF` of the ground; of a support its number.
        measured: (N,), in the quantity's unit.
        label: What the user calls the DOF; "": its number.
        there: (N,) bool, where a sample was measured; None: everywhere.
        gauge: Where it is no column: what it feels; its number among the record's gauges is then the DOF.
    """

    quantity: str
    dof: int
    measured: np.ndarray
    label: str = ""
    there: np.ndarray | None = None
    gauge: Gauge | None = None

    @property
    def name(self) -> str:
        """See :func:`named`."""
        return named(self.quantity, self.where) if self.gauge is None else sensor_name(self.gauge)

    @property
    def where(self) -> str:
        """Name of the DOF or of the sensor, or the DOF's number, counted from 1."""
        return self.label or str(self.dof + 1)

    @property
    def place(self) -> tuple[str, int]:
        """Quantity and column among those of the quantity, from 0."""
        return self.quantity, max(self.dof, 0)

    @property
    def setting(self) -> str:
        """Where a user gave it: ``data.acceleration, DOF 3``."""
        if self.gauge is not None:
            return f"data.channels.{self.where}"
        if self.quantity in SUPPORT:
            return f"data.channels, {self.name}"
        return f"data.{GROUND}" if self.quantity == GROUND else f"data.{self.quantity}, DOF {self.where}"

    @property
    def order(self) -> int:
        """How often the displacement is differentiated."""
        quantity = SUPPORT.get(self.quantity, self.quantity)
        return RESPONSE_QUANTITIES.index("acceleration" if quantity == GROUND else quantity)

    def sampled(self, values: np.ndarray) -> np.ndarray:
        """Those of the values (N,) that belong to a sample."""
        return values if self.there is None else values[self.there]

    def of(self, response: Response) -> np.ndarray:
        """The same quantity of the same DOF in a response, (N,); NaN where it has none of ground or support."""
        if self.gauge is not None:
            return self.gauge.felt_in(response)
        if self.quantity in SUPPORT:
            moved = response.supports
            return np.full(len(response.time), np.nan) if moved is None else moved[:, self.order, self.dof]
        values: np.ndarray | None = getattr(response, self.quantity)
        if self.quantity == GROUND:
            return np.full(len(response.time), np.nan) if values is None else values
        assert values is not None
        return np.asarray(values[:, self.dof])


def named(quantity: str, where: str) -> str:
    """A channel as sentences have it: ``acceleration of DOF 3``, ``ground acceleration``."""
    if quantity in SUPPORT:
        return f"{SUPPORT[quantity]} of support {where}"
    return "ground acceleration" if quantity == GROUND else f"{quantity} of DOF {where}"


def sensor_name(gauge: Gauge) -> str:
    """The same of a sensor that fills no column: ``displacement of sensor eps``."""
    return f"{gauge.quantity} of sensor {gauge.name}"


def channel_name(record: Record, quantity: str, number: int) -> str:
    """The same of a column of a record; its number is counted from 0."""
    return named(quantity, _label(record, quantity, number))


def _label(record: Record, quantity: str, number: int) -> str:
    return record.support_names[number] if quantity in SUPPORT else record.dof_name(number)


def channels(
    record: Record, quantities: Sequence[str] = RESPONSE_QUANTITIES, excused: Sequence[str] = ()
) -> list[Channel]:
    """Every sensor of a record, quantity by quantity, the ground's last; a force that is known to be zero is none."""
    asked = [quantity for quantity in quantities if quantity in QUANTITIES]
    asked += [quantity for quantity in record.supports if quantity in quantities]
    every = [
        Channel(quantity, i, record.histories(quantity)[:, i], _label(record, quantity, i), record.there(quantity, i))
        for quantity in asked
        for i in np.flatnonzero(record.sensors(quantity)).tolist()
    ]
    if GROUND in quantities and record.ground_acceleration is not None:
        every.append(Channel(GROUND, GROUND_DOF, record.ground_acceleration, there=record.there(GROUND, 0)))
    return [channel for channel in every if channel.name not in excused]


def every_channel(record: Record, quantities: Sequence[str] = MEASURED_QUANTITIES) -> list[Channel]:
    """The same, and behind them sensors that fill no column: of sums, of connections, a second one of a kind."""
    return channels(record, quantities) + [
        Channel(gauge.quantity, number, column, gauge.name, there, gauge)
        for number, gauge in enumerate(record.gauges)
        if gauge.name in record.beside and np.isfinite(column := record.beside[gauge.name][0]).all()
        for there in [record.beside[gauge.name][1]]
    ]


def clipped_percent(signal: np.ndarray) -> float:
    """Share of samples (N,) that sit at the channel's own largest or least value, %; 0 of one or two.

    A value that is the median is none that the channel was clipped at: a hammer's force rests at its least value.
    """
    clipped, rest = 0, np.median(signal)
    for extreme in {float(signal.max()), float(signal.min())}:
        count = int(np.sum(signal == extreme))
        clipped += count if count > AT_EXTREME_BY_CHANCE and extreme != rest else 0
    return 100.0 * clipped / len(signal)


def constant_percent(signal: np.ndarray) -> float:
    """Share of samples (N,) in runs of `CONSTANT_RUN` or more equal values, zeros included, %."""
    return 100.0 * sum(end - begin for begin, end in equal_runs(signal)) / len(signal)


def equal_runs(signal: np.ndarray) -> list[tuple[int, int]]:
    """First and last index + 1 of every run of `CONSTANT_RUN` equal samples (N,) or more."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(signal)) + 1, [len(signal)]])
    long = np.flatnonzero(np.diff(edges) >= CONSTANT_RUN)
    return list(zip(edges[long].tolist(), edges[long + 1].tolist(), strict=True))


def hum(signal: np.ndarray, step: float, acting: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """Frequency of the mains, Hz, of which a signal (N,) has a line, and the line's share of its power.

    None where it has none, or where something that acts (N,) has it too: then it may be a machine.
    """
    steadiness, share, line = max((*_steadiness(signal, one * step), one) for one in MAINS)
    if not (steadiness > STEADY_LINE and share > LEAST_HUM):
        return None
    acts = any(_steadiness(other, line * step)[0] > FAINT for other in acting)
    return None if acts else (line, share)


def _steadiness(signal: np.ndarray, turns: float) -> tuple[float, float]:
    """How steady a line is, as F with 2 and 2 (`LINE_PARTS` - 1) degrees of freedom, and its share of the power.

    Args:
        signal: (N,).
        turns: Of the line from sample to sample; beyond one half it shows where its samples put it.
    """
    turns, each = abs(turns - round(turns)), len(signal) // LINE_PARTS
    if min(turns, 0.5 - turns) * each < 2.0:  # no line of its own
        return 0.0, 0.0
    window = np.hanning(each + 2)[1:-1]
    turned = (signal - signal.mean())[: LINE_PARTS * each] * np.exp(-2j * np.pi * turns * np.arange(LINE_PARTS * each))
    parts = turned.reshape(LINE_PARTS, each) @ (window / window.sum())
    line, variance = abs(parts.mean()) ** 2, float(np.sum(np.abs(parts - parts.mean()) ** 2)) / (LINE_PARTS - 1)
    return LINE_PARTS * line / max(variance, 1e-300), 2.0 * line / max(float(np.var(signal)), 1e-300)


def record_band(record: Record) -> float:
    """The widest band of any measured channel of the record, Hz; at least the record's own frequency resolution.

    The motion of the ground, or of a support, is followed as far as it may reach: where it shows no noise above its
    content, that is all that can be used.
    """
    bands = [
        signal_band(record.histories(quantity)[:, dof], record.step)
        for quantity in (*record.response_quantities, "force")
        for dof in np.flatnonzero(record.sensors(quantity))
    ]
    usable = USABLE_NYQUIST_FRACTION * 0.5 / record.step
    for quantity in record.response_quantities[len(RESPONSE_QUANTITIES) :]:
        bands += [
            usable
            for moved in record.histories(quantity)[:, record.sensors(quantity)].T
            if visible_floor(moved, record.step) is None
        ]
    return max(*bands, 1.0 / record.duration)


def motion_amplitudes(record: Record) -> dict[str, float]:
    """Root mean square of displacement (m), velocity (m/s) and acceleration (m/s^2) where the record moves most.

    A quantity without a sensor comes from the measured one that is fewest derivatives away, integrated or
    differentiated in the frequency domain over the record's band. Hidden DOFs may move more: only orders of magnitude
    matter to those who scale their numbers by it.

    Returns:
        Quantity to its amplitude; 1 where the channel that it comes from shows nothing at all.
    """
    measured = [order for order, quantity in enumerate(RESPONSE_QUANTITIES) if record.sensors(quantity).any()]
    band = record_band(record)
    amplitudes = {}
    for order, quantity in enumerate(RESPONSE_QUANTITIES):
        source = min(measured, key=lambda given, order=order: abs(given - order))  # type: ignore[misc]
        name = RESPONSE_QUANTITIES[source]
        channels = getattr(record, name)[:, record.sensors(name)]
        amplitudes[quantity] = max(_rms(channel, record.step, band, order - source) for channel in channels.T) or 1.0
    return amplitudes


def slowest_motion(record: Record) -> float:
    """Least ratio of rms acceleration to rms displacement over the measured channels, 1/s^2.

    Motion far from a force is slower than near it, so of what was measured the slowest channel comes nearest to what
    was not.
    """
    band = record_band(record)
    ratios = []
    for order, name in enumerate(RESPONSE_QUANTITIES):
        for channel in getattr(record, name)[:, record.sensors(name)].T:
            displacement, acceleration = (_rms(channel, record.step, band, q - order) for q in (0, 2))
            if displacement > 0:
                ratios.append(acceleration / displacement)
    return min(ratios, default=(math.pi * band) ** 2)


def support_amplitudes(record: Record) -> np.ndarray:
    """(S,), root mean square of the displacement of every support, m."""
    band, out = record_band(record), np.zeros(len(record.support_names))
    for quantity, values in reversed(list(record.supports.items())):
        for i in np.flatnonzero(record.sensors(quantity)):
            order = RESPONSE_QUANTITIES.index(SUPPORT[quantity])
            out[i] = _rms(values[:, i] - values[:, i].mean(), record.step, band, -order)
    return out


def _rms(channel: np.ndarray, step: float, band: float, derivatives: int) -> float:
    """Root mean square of a channel (N,) after so many time derivatives; negative ones are integrals."""
    if derivatives == 0:
        return float(np.sqrt(np.mean(channel**2)))
    frequency, power = periodogram(channel, step)
    kept = slice(LOWEST_BINS, max(LOWEST_BINS + 1, int(np.searchsorted(frequency, band, side="right"))))
    gain = (2.0 * np.pi * frequency[kept]) ** (2 * derivatives)
    return float(np.sqrt(2.0 * np.sum(gain * power[kept]) / len(channel)))
