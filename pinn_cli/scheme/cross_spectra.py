"""A record in the frequency domain: what its forces and its sensors have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.record.response import GROUND, RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import LOWEST_BINS, group_starts, lowest_level
from pinn_cli.record.supports import told_by
from pinn_cli.scheme.lagged_products import Products
from pinn_cli.system.quantities import FORCE

# Frequencies closer than this part of their value are taken together: no resonance is narrower that is worth a start.
RELATIVE_RESOLUTION = 0.005
# Frequencies at most, for few and for many DOFs: a dense matrix is inverted at each.
MOST_FREQUENCIES, MANY_DOFS, MOST_FOR_MANY = 1200, 12, 200
# The spectra reach this far beyond the record's band, where resonances of other sensors' noise may hide.
BEYOND_BAND = 1.0


@dataclass(frozen=True, eq=False)
class CrossSpectra:
    """Averaged products of the spectra of what acts and of sensors, over groups of neighbouring frequencies.

    What acts, F of it, are the measured forces, the motions of supports and last, where it moves, the ground's
    acceleration.

    Attributes:
        omega: (B,), rad/s.
        forced: DOFs of the load cells, from 0.
        felt: (S,) bool, the sensors that feel the ground's acceleration; None where it is at rest.
        carried: Of every support that moves how often its displacement is differentiated in what was measured.
        sensors: (S,), DOFs of the response sensors, from 0.
        orders: (S,), 0, 1, 2 for displacement, velocity, acceleration.
        of_forces: (B, F, F), force times conjugate force.
        of_both: (B, S, F), response times conjugate force.
        of_sensors: (B, S), power of the response; where samples are missing, with the scatter that this brings.
        of_acting: (B, F), power of what acts, likewise.
        scatter: (B, S, F), variance that missing samples bring to one frequency of ``of_both``; None: none is missing.
        count: (B,), frequencies in every group.
        force_floor, sensor_floor: (F,) and (S,), what white noise adds to either power, at most.
    """

    omega: np.ndarray
    forced: np.ndarray
    sensors: np.ndarray
    orders: np.ndarray
    of_forces: np.ndarray
    of_both: np.ndarray
    of_sensors: np.ndarray
    of_acting: np.ndarray
    scatter: np.ndarray | None
    count: np.ndarray
    force_floor: np.ndarray
    sensor_floor: np.ndarray
    felt: np.ndarray | None = None
    carried: tuple[int, ...] = ()

    @classmethod
    def of(cls, record: Record, records: int = 1) -> CrossSpectra | None:
        """Of a record whose forces are all measured or known to be zero; None of another.

        Args:
            record: Whose.
            records: How many are looked at together: so many times fewer frequencies of each will do.
        """
        forced, ground = np.flatnonzero(record.sensors("force")), record.ground_acceleration
        moves = ground is not None or bool(record.supports)
        if (not len(forced) and not moves) or not np.isfinite(record.force).all():
            return None
        return cls._of(record, records, forced, ground, told_by(record))

    @classmethod
    def of_sensors_alone(cls, record: Record, records: int = 1) -> CrossSpectra:
        """The same of any record, with nothing that acts; where samples are missing, of what its columns show there."""
        return cls._of(record, records, np.zeros(0, dtype=int), None)

    @classmethod
    def _of(
        cls,
        record: Record,
        records: int,
        forced: np.ndarray,
        ground: np.ndarray | None,
        supports: Sequence[tuple[str, int]] = (),
    ) -> CrossSpectra:
        carried = [record.supports[quantity][:, i] for i, (quantity, _) in enumerate(supports)]
        acting = np.column_stack((record.force[:, forced], *carried, *([] if ground is None else [ground])))
        channels = [(q, int(dof)) for q in RESPONSE_QUANTITIES for dof in np.flatnonzero(record.sensors(q))]
        measured = np.stack([getattr(record, q)[:, dof] for q, dof in channels], axis=1)
        driving = [(FORCE, int(dof)) for dof in forced] + [(quantity, i) for i, (quantity, _) in enumerate(supports)]
        driving += [] if ground is None else [(GROUND, 0)]
        products = Products.of_samples(record, acting, measured, driving, channels if driving else [])
        frequency = np.fft.rfftfreq(len(record.time), record.step)
        last = int(np.searchsorted(frequency, BEYOND_BAND * record_band(record), side="right"))
        most = max(MOST_FREQUENCIES // records, MOST_FOR_MANY) if record.ndof <= MANY_DOFS else MOST_FOR_MANY
        first = np.array(_group_starts(LOWEST_BINS, max(last, LOWEST_BINS + 8), most))
        first = first[first < len(frequency)]
        stop = np.append(first[1:], min(max(last, LOWEST_BINS + 8), len(frequency)))
        count = np.maximum(stop - first, 1)

        def averaged(values: np.ndarray) -> np.ndarray:
            sums = np.add.reduceat(values[: stop[-1]], first, axis=0)
            return sums / count.reshape(-1, *[1] * (values.ndim - 1))

        return cls(
            2.0 * np.pi * averaged(frequency),
            forced,
            np.array([dof for _, dof in channels]),
            np.array([RESPONSE_QUANTITIES.index(q) for q, _ in channels]),
            averaged(products.of_forces),
            averaged(products.of_both),
            averaged(products.of_sensors),
            averaged(products.acting),
            products.scatter_of(averaged),
            count,
            _floor(acting, record.step),
            _floor(measured, record.step),
            None
            if ground is None
            else np.array([q == "acceleration" and record.frame == "absolute" for q, _ in channels]),
            tuple(order for _, order in supports),
        )

    @property
    def channels(self) -> list[tuple[str, int]]:
        """Quantity and DOF, from 0, of the response sensors."""
        return [(RESPONSE_QUANTITIES[order], int(dof)) for order, dof in zip(self.orders, self.sensors, strict=True)]

    @cached_property
    def differentiation(self) -> np.ndarray:
        """(B, S), from displacement to what each sensor measures."""
        return (1j * self.omega[:, None]) ** self.orders

    def smoothing(self, width: float) -> np.ndarray:
        """(O, B), averages over neighbours by a Gaussian of a relative width in frequency; fewer where it is wide."""
        low, high = np.log(self.omega[0]), np.log(self.omega[-1])
        centres = np.linspace(low, high, int(min(len(self.omega), max(8, 2.0 * (high - low) / width))))
        spacing = np.gradient(self.omega) / self.omega
        weights = spacing * np.exp(-0.5 * ((np.log(self.omega) - centres[:, None]) / width) ** 2)
        kept = weights.sum(axis=1) > 0
        return weights[kept] / weights[kept].sum(axis=1, keepdims=True)


def _floor(x: np.ndarray, step: float) -> np.ndarray:
    """(C,) power of white noise in the spectra of channels (N, C), at most."""
    return np.array([lowest_level(column, step) for column in x.T]) ** 2 * float(np.sum(np.hanning(len(x)) ** 2))


def _group_starts(first: int, stop: int, most: int) -> list[int]:
    """See :func:`group_starts`: so many at most."""
    resolution = RELATIVE_RESOLUTION
    while len(starts := group_starts(first, stop, resolution)) > most:
        resolution *= 1.5
    return starts
