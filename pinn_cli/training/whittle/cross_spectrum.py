"""All channels of a record in the frequency domain: what they have in common at every frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import group_starts, signal_edges

# Part of the record that the taper takes at both ends together: what resonances leak falls off steeply then.
TAPERED = 0.1
# Frequencies closer than this part of their value are taken together: far less than a resonance is wide.
RELATIVE_RESOLUTION = 0.002
# The lowest frequencies hold the mean and slow drift.
LOWEST_BINS = 3
# What is left of the band: at its edge an anti-alias filter, or the forces themselves, have begun to fall off.
BELOW_EDGE = 0.9
# Bins of the least band that is worth a look.
FEWEST_BINS = 32


@dataclass(frozen=True, eq=False)
class CrossSpectrum:
    """Periodograms and cross periodograms of all channels, averaged over groups of neighbouring frequencies.

    White noise of variance s^2 reads s^2. The channels are the response sensors, then the load cells.

    Attributes:
        omega: (G,), rad/s.
        count: (G,), independent values of every channel in a group, fewer than frequencies since the taper correlates
            them.
        power: (G, S + L, S + L), channel times conjugate channel.
        sensors: (S,), quantity and DOF, from 0, of every response sensor.
        loads: (L,), DOFs, from 0, of the load cells.
    """

    omega: np.ndarray
    count: np.ndarray
    power: np.ndarray
    sensors: tuple[tuple[str, int], ...]
    loads: tuple[int, ...]

    @classmethod
    def of(cls, record: Record) -> CrossSpectrum | None:
        """Over the record's own band; None where that holds too little."""
        from scipy.signal.windows import tukey  # not above: few runs come here, and it takes 0.15 s to import

        sensors = tuple((q, int(dof)) for q in RESPONSE_QUANTITIES for dof in np.flatnonzero(record.sensors(q)))
        loads = tuple(int(dof) for dof in np.flatnonzero(record.sensors("force")))
        columns = [getattr(record, q)[:, dof] for q, dof in sensors] + [record.force[:, dof] for dof in loads]
        channels, taper = np.stack(columns, axis=1), tukey(len(record.time), TAPERED)
        spectrum = np.fft.rfft((channels - channels.mean(0)) * taper[:, None], axis=0) / np.sqrt(np.sum(taper**2))
        frequency = np.fft.rfftfreq(len(record.time), record.step)
        edges = np.array([signal_edges(column, record.step)[0] for column in columns[: len(sensors)]])
        lowest = np.min(edges, initial=np.inf, where=np.isfinite(edges))
        first = max(LOWEST_BINS, int(np.searchsorted(frequency, lowest)))
        last = int(np.searchsorted(frequency, BELOW_EDGE * record_band(record), side="right"))
        if not last - first >= FEWEST_BINS:
            return None
        starts = group_starts(first, last, RELATIVE_RESOLUTION)
        size = np.diff([*starts, last])

        def averaged(values: np.ndarray) -> np.ndarray:
            sums: np.ndarray = np.add.reduceat(values[:last], starts, axis=0)
            return sums / size.reshape(-1, *[1] * (values.ndim - 1))

        share = float(np.sum(taper**2) ** 2 / (len(taper) * np.sum(taper**4)))
        power = averaged(spectrum[:, :, None] * spectrum[:, None, :].conj())
        return cls(2.0 * np.pi * averaged(frequency), share * size, power, sensors, loads)
