"""Spectra of one measured force and of the response sensors at the lines of a band."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES

# Of the filter, at lines that are used: further out, noise that leaks there from the band is larger than their own.
LEAST_GAIN = 0.7


@dataclass(frozen=True, eq=False)
class BandSpectra:
    """Discrete Fourier transforms of a record, without taper: what that leaks is a term of the model.

    The lines reach into the flanks of the record's filter: a mode that lies there is seen by its own resonance. What
    the filter takes off is put on again.

    Attributes:
        frequency: (B,), Hz, of the lines within the band and its flanks.
        force: (B,), N.
        response: (B, S), of the sensors, each over its rms in the band.
        scale: (S,), those rms, in the sensors' units.
        orders: (S,), 0, 1, 2 of displacement, velocity, acceleration.
        sensors: (S,), quantity and DOF, from 0.
        band: Hz.
        samples: Of the record.
        gain: (B,), of the filter.
    """

    frequency: np.ndarray
    force: np.ndarray
    response: np.ndarray
    scale: np.ndarray
    orders: np.ndarray
    sensors: tuple[tuple[str, int], ...]
    band: tuple[float, float]
    samples: int
    gain: np.ndarray

    @classmethod
    def of(cls, record: Record, driven: int) -> BandSpectra:
        """Of a record with a band, whose one force is measured on the DOF ``driven``, from 0."""
        assert record.band is not None
        sensors = tuple((q, int(dof)) for q in RESPONSE_QUANTITIES for dof in np.flatnonzero(record.sensors(q)))
        columns = [record.force[:, driven], *(getattr(record, q)[:, dof] for q, dof in sensors)]
        frequency = np.fft.rfftfreq(len(record.time), record.step)
        gain = record.band.gain(frequency)
        lines = gain > LEAST_GAIN
        spectra = np.fft.rfft(np.stack(columns, axis=1), axis=0)[lines] / gain[lines, None]
        response = spectra[:, 1:]
        scale = np.sqrt(np.mean(np.abs(response) ** 2, axis=0))
        orders = np.array([RESPONSE_QUANTITIES.index(quantity) for quantity, _ in sensors])
        return cls(
            frequency[lines], spectra[:, 0], response / scale, scale, orders, sensors, record.band.edges,
            len(record.time), gain[lines],
        )  # fmt: skip

    @cached_property
    def s(self) -> np.ndarray:
        """(B,), the Laplace variable, rad/s."""
        return 2j * np.pi * self.frequency

    @cached_property
    def driving(self) -> np.ndarray:
        """(B, S), the force as often differentiated as the displacement in what each sensor measures."""
        return self.s[:, None] ** self.orders * self.force[:, None]
