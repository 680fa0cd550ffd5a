"""The channels of a record: their band, how large the motion is, what a sensor has not followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.response import MEASURED_QUANTITIES, QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import (
    LOWEST_BINS,
    USABLE_NYQUIST_FRACTION,
    periodogram,
    signal_band,
    signal_edges,
    visible_floor,
)
from pinn_cli.system.quantities import GROUND, SUPPORT

# Part of a channel's spread, or of whatever else is estimated, to which it is known at best: below it rounding and the
# splines' own error rule.
FINEST_KNOWN = 1e-6
# Records whose band and amplitudes are kept: a run asks for those of the same few some hundred times.
RECENT = 4


def channels(
    record: Record, quantities: Sequence[str] = RESPONSE_QUANTITIES, excused: Sequence[str] = ()
) -> list[Channel]:
    """Columns of a record, quantity by quantity, the ground's last; a force that is known to be zero is none."""
    asked = [quantity for quantity in quantities if quantity in QUANTITIES]
    asked += [quantity for quantity in record.supports if quantity in quantities]
    asked += [GROUND] if GROUND in quantities and record.measured_ground is not None else []
    columns = [
        record.column(quantity, i) for quantity in asked for i in np.flatnonzero(record.sensors(quantity)).tolist()
    ]
    return [channel for channel in columns if channel.name not in excused]


def every_channel(record: Record, quantities: Sequence[str] = MEASURED_QUANTITIES) -> list[Channel]:
    """The same, and behind them sensors that have no column: of sums, of connections, a second one of a kind."""
    return channels(record, quantities) + [
        channel for channel in record.corrected if not channel.is_column and np.isfinite(channel.measured).all()
    ]


@lru_cache(maxsize=RECENT)
def record_band(record: Record) -> float:
    """The widest band of any measured channel of the record, Hz; at least the record's own frequency resolution.

    The motion of the ground, or of a support, is followed as far as it may reach: where it shows no noise above its
    content, that is all that can be used.
    """
    columns, usable = channels(record, MEASURED_QUANTITIES), USABLE_NYQUIST_FRACTION * 0.5 / record.step
    bands = [signal_band(channel.measured, record.step) for channel in columns]
    moved = [channel.measured for channel in columns if channel.quantity not in QUANTITIES]
    bands += [usable for history in moved if visible_floor(history, record.step) is None]
    return max(*bands, 1.0 / record.duration)


@lru_cache(maxsize=RECENT)
def motion_amplitudes(record: Record) -> dict[str, float]:
    """Root mean square of displacement (m), velocity (m/s) and acceleration (m/s^2) where the record moves most.

    A quantity without a sensor comes from the measured one that is fewest derivatives away, integrated or
    differentiated in the frequency domain over the record's band; integrals begin where the channel stands out of its
    noise, which they would make a displacement of metres. Hidden DOFs may move more: only orders of magnitude matter
    to those who scale their numbers by it. It is 1 where the channel that it comes from shows nothing at all.
    """
    columns, band, amplitudes = channels(record), record_band(record), {}
    for order, quantity in enumerate(RESPONSE_QUANTITIES):
        source = min((channel.order for channel in columns), key=lambda given, order=order: abs(given - order))  # type: ignore[misc]
        nearest = [channel.measured for channel in columns if channel.order == source]
        amplitudes[quantity] = max(_rms(history, record.step, band, order - source) for history in nearest) or 1.0
    return amplitudes


def slowest_motion(record: Record) -> float:
    """Least ratio of rms acceleration to rms displacement over the measured channels, 1/s^2.

    Motion far from a force is slower than near it, so of what was measured the slowest channel comes nearest to what
    was not.
    """
    band, ratios = record_band(record), []
    for channel in channels(record):
        displacement, acceleration = (_rms(channel.measured, record.step, band, q - channel.order) for q in (0, 2))
        if displacement > 0:
            ratios.append(acceleration / displacement)
    return min(ratios, default=(math.pi * band) ** 2)


def support_amplitudes(record: Record) -> np.ndarray:
    """(S,), root mean square of the displacement of every support, m."""
    band, out = record_band(record), np.zeros(len(record.support_names))
    for channel in reversed(channels(record, tuple(SUPPORT))):
        history = channel.measured - channel.measured.mean()
        out[channel.dof] = _rms(history, record.step, band, -channel.order)
    return out


def _rms(channel: np.ndarray, step: float, band: float, derivatives: int) -> float:
    """Root mean square of a channel (N,) after so many time derivatives; negative ones are integrals."""
    if derivatives == 0:
        return float(np.sqrt(np.mean(channel**2)))
    frequency, power = periodogram(channel, step)
    lowest = np.fmax(signal_edges(channel, step)[0], frequency[1]) if derivatives < 0 else frequency[1]
    first = max(LOWEST_BINS, int(np.searchsorted(frequency, min(lowest, band))))
    kept = slice(first, max(first + 1, int(np.searchsorted(frequency, band, side="right"))))
    gain = (2.0 * np.pi * frequency[kept]) ** (2 * derivatives)
    return float(np.sqrt(2.0 * np.sum(gain * power[kept]) / len(channel)))
