"""Cross spectra of channels that miss samples, from the pairs of samples that are there.

A straight line through a gap is no measurement, and neither is 0. Of two channels the products of samples a lag apart
are added over the pairs that are there, and the sum is scaled to as many pairs as complete channels have. That is the
sum of complete channels but for scatter, as long as what acts is much the same throughout. Its Fourier transform over
the lag is the cross spectrum (Blackman and Tukey 1958; Parzen 1963 for missing samples).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.gauge import Gauge
from pinn_cli.record.record import Record
from pinn_cli.system.quantities import FORCE, GROUND

# A lag of which fewer of the pairs are there than this is left out: it would be scatter alone.
FEWEST_PAIRS = 0.01
# From sample to sample a channel that misses none takes at most this many steps of the record.
WHOLE = 1.5
# Samples lie off the record's times by half a step at most: so many terms of a Taylor series tell their phases well
# enough.
PHASE_TERMS, PHASE_ERROR = 14, 1e-6


def misses_samples(gauge: Gauge, record: Record) -> bool:
    """Whether the column of a gauge shows more than its samples do.

    A load cell whose own samples are even is not counted: nothing better is known than that its band ends where these
    can follow it.
    """
    step = gauge.even_step
    return step is None or (step > WHOLE * record.step and gauge.quantity not in (FORCE, GROUND))


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of one channel under the window of the whole record, transformed over twice its length.

    Attributes:
        values: (N + 1,), of the samples, their mean taken out.
        places: (N + 1,), of ones at the samples.
        count: Samples of the record, N.
    """

    values: np.ndarray
    places: np.ndarray
    count: int

    @classmethod
    def of_column(cls, column: np.ndarray) -> Samples:
        """Of a channel (N,) with a sample at every time."""
        window = np.hanning(len(column))
        return cls(_doubled((column - column.mean()) * window), _doubled(window), len(column))

    @classmethod
    def of_gauge(cls, gauge: Gauge, record: Record) -> Samples:
        """Of a gauge, as it is believed to be calibrated, at its own times."""
        count, step = len(record.time), record.step
        felt_at, felt = gauge.calibrated()
        position = (felt_at - record.time[0]) / step
        place = np.rint(position).astype(np.int64)
        inside = (place >= 0) & (place < count)
        place, off, felt = place[inside], (position - place)[inside], felt[inside]
        weight = np.hanning(count)[place]
        swing = weight * (felt - np.average(felt, weights=weight))
        turn = -2j * np.pi * np.fft.rfftfreq(2 * count)
        values, term = np.zeros(count + 1, complex), np.ones(count + 1, complex)
        for order in range(PHASE_TERMS):
            values += term * _doubled(np.bincount(place, swing * off**order, minlength=count))
            if (np.pi * np.abs(off).max(initial=0.0)) ** (order + 1) < PHASE_ERROR:
                break
            term = term * turn / (order + 1)
        return cls(values, _doubled(np.bincount(place, weight, minlength=count)), count)

    def power(self) -> np.ndarray:
        """(N // 2 + 1,) power of the samples, as large in all as that of a complete channel, scatter included."""
        part = self.places[0].real / float(np.hanning(self.count).sum())
        folded = np.fft.irfft(self.values)
        power: np.ndarray = np.abs(np.fft.rfft(folded[: self.count] + folded[self.count :])) ** 2
        return power / part**2


def cross_spectrum(a: Samples, b: Samples) -> np.ndarray:
    """(N // 2 + 1,) spectrum of a times the conjugate one of b, of channels that miss no sample but for scatter."""
    every = Samples.of_column(np.ones(a.count)).places
    products, there, pairs = (
        np.fft.irfft(x) for x in (a.values * b.values.conj(), a.places * b.places.conj(), np.abs(every) ** 2)
    )
    seen = there > FEWEST_PAIRS * pairs + 1e-9 * pairs[0]
    products = np.where(seen, products * pairs / np.where(seen, there, 1.0), 0.0)
    spectrum: np.ndarray = np.fft.rfft(products[: a.count] + products[a.count :])
    return spectrum


@dataclass(frozen=True, eq=False)
class Products:
    """Products of the spectra of what acts and of sensors, at every frequency of a record.

    Attributes:
        of_forces, of_both, of_sensors, acting: See :class:`pinn_cli.scheme.cross_spectra.CrossSpectra`.
        complete: (B, S) and (B, F), powers without scatter; None: no sample is missing.
    """

    of_forces: np.ndarray
    of_both: np.ndarray
    of_sensors: np.ndarray
    acting: np.ndarray
    complete: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def of_samples(
        cls,
        record: Record,
        acting: np.ndarray,
        measured: np.ndarray,
        driving: Sequence[tuple[str, int]],
        sensors: Sequence[tuple[str, int]],
    ) -> Products:
        """Of a record.

        Args:
            record: Whose gauges may miss samples.
            acting: (N, F), columns of what acts.
            measured: (N, S), columns of the sensors.
            driving: What each of the former is, quantity and channel.
            sensors: The same of the latter.
        """
        forces, responses = _spectrum(acting), _spectrum(measured)
        out = cls(
            np.einsum("bi,bj->bij", forces, forces.conj()),
            np.einsum("bs,bj->bsj", responses, forces.conj()),
            np.abs(responses) ** 2,
            np.abs(forces) ** 2,
        )
        gaps = {(g.quantity, g.dof): g for g in record.gauges if g.dof is not None and misses_samples(g, record)}
        if not gaps.keys() & {*driving, *sensors}:
            return out

        def samples(columns: np.ndarray, channels: Sequence[tuple[str, int]]) -> list[Samples]:
            return [
                Samples.of_gauge(gaps[channel], record) if channel in gaps else Samples.of_column(column)
                for column, channel in zip(columns.T, channels, strict=True)
            ]

        return out._of_pairs(samples(acting, driving), samples(measured, sensors))

    def _of_pairs(self, acting: Sequence[Samples], measured: Sequence[Samples]) -> Products:
        """The same from the samples that are there."""
        of_acting = [[cross_spectrum(a, b) for b in acting] for a in acting]
        of_both = [[cross_spectrum(a, b) for b in acting] for a in measured]
        powers = [np.stack([x.power() for x in of], axis=1) for of in (acting, measured)]
        complete = [np.stack([cross_spectrum(x, x).real for x in of], axis=1) for of in (measured, acting)]
        return Products(
            np.moveaxis(np.array(of_acting), 2, 0),
            np.moveaxis(np.array(of_both), 2, 0),
            powers[1],
            powers[0],
            (complete[0], complete[1]),
        )

    def scatter_of(self, averaged: Callable[[np.ndarray], np.ndarray]) -> np.ndarray | None:
        """(B, S, F) variance that missing samples bring to ``of_both``, as ``averaged`` groups frequencies."""
        if self.complete is None:
            return None
        with_it, without = (
            averaged(sensed)[:, :, None] * averaged(acting)[:, None, :]
            for sensed, acting in ((self.of_sensors, self.acting), self.complete)
        )
        return np.maximum(with_it - without, 0.0)


def _spectrum(x: np.ndarray) -> np.ndarray:
    return np.fft.rfft((x - x.mean(axis=0)) * np.hanning(len(x))[:, None], axis=0)


def _doubled(values: np.ndarray) -> np.ndarray:
    spectrum: np.ndarray = np.fft.rfft(values, 2 * len(values))
    return spectrum
