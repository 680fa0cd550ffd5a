"""How large the motion of a record is, read off the channels that were measured."""

from __future__ import annotations

import math

import numpy as np

from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import LOWEST_BINS, periodogram
from pinn_cli.system.quantities import SUPPORT


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
