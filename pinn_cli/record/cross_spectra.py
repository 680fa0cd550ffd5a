"""Cross spectra: what channels have in common at every frequency, averaged over pieces of a record or over bands.

A straight line through a gap is no measurement, and neither is 0. Of two channels one of which misses samples, the
products of samples a lag apart are added over the pairs that are there, and the sum is scaled to as many pairs as
complete channels have. That is the sum of complete channels but for scatter, as long as what acts is much the same
throughout. Its Fourier transform over the lag is the cross spectrum (Blackman and Tukey 1958; Parzen 1963 for missing
samples).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Protocol, TypeVar

import numpy as np

from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import lowest_level
from pinn_cli.system.quantities import FORCE, GROUND

# Frequencies closer than this part of their value are taken together: far less than a resonance is wide.
RELATIVE_RESOLUTION = 0.002
# Half overlapping pieces of a record: a sixteenth of it, but not below or above so many samples.
PIECES, FEWEST_PIECES, SHORTEST_PIECE, LONGEST_PIECE = 16, 4, 1024, 2**15
# Added to a matrix of spectra, of its trace: several forces may be the same.
SPECTRA_RIDGE = 1e-9
# A lag of which fewer of the pairs are there than this is left out: it would be scatter alone.
FEWEST_PAIRS = 0.01
# From sample to sample a channel that misses none takes at most this many steps of the record.
MISSES_NONE = 1.5
# Samples lie off the record's times by half a step at most: so many terms of a Taylor series tell their phases.
PHASE_TERMS = 12


class Source(Protocol):
    """What a channel is of."""

    @property
    def order(self) -> int:
        """How often the displacement is differentiated in what a response sensor shows."""


S = TypeVar("S", bound=Source)


@dataclass(frozen=True, eq=False)
class CrossSpectra(Generic[S]):
    """Averaged products of the spectra of channels; white noise of variance s^2 has the power s^2.

    Attributes:
        sensors: S of them, of the response.
        acting: F of them, of what acts; their columns stand behind those of the sensors.
        values: (N, S + F), the channels.
        step: From sample to sample, s.
        frequency: (B,), Hz.
        count: (B,), independent products of which each is the mean: one in so many is the relative variance of a power.
        cross: (B, S + F, R), channel times conjugate channel, the latter the last R ones.
        power: (B, S + F), of every channel; where samples are missing, with the scatter that this brings.
    """

    sensors: Sequence[S]
    acting: Sequence[S]
    values: np.ndarray
    step: float
    frequency: np.ndarray
    count: np.ndarray
    cross: np.ndarray
    power: np.ndarray

    @classmethod
    def of_pieces(cls, sensors: Sequence[S], acting: Sequence[S], values: np.ndarray, step: float) -> CrossSpectra[S]:
        """Of all pairs of channels without gaps, averaged over pieces by Welch's method."""
        length = piece_length(len(values))
        first = range(0, len(values) - length + 1, length - length // 2)
        window, channels = taper(length), values.shape[1]
        cross = np.zeros((length // 2 + 1, channels, channels), complex)
        for at in first:
            lines = _lines(values[at : at + length], window)
            cross += lines[:, :, None] * lines[:, None, :].conj() / len(first)
        # Pieces that overlap by half count as if they did not.
        count = np.full(len(cross), len(first))
        power = np.einsum("bcc->bc", cross).real
        return cls(sensors, acting, values, step, np.fft.rfftfreq(length, step), count, cross, power)

    @classmethod
    def of_bands(
        cls,
        record: Record,
        sensors: Sequence[Channel],
        acting: Sequence[Channel],
        edges: Sequence[int],
        references: int | None = None,
        tapered: float = 1.0,
    ) -> CrossSpectra[Channel]:
        """Of channels of a record, averaged over groups of neighbouring lines of its whole spectrum.

        Its channels, of the response and of what acts, may miss samples. Edges are the first line of every group, and
        the line behind the last one. References are channels, counted from the last one, of which products are taken;
        None: what acts. Without any the power is that of the columns, as they look where samples are missing.
        """
        channels = [*sensors, *acting]
        values, references = np.stack([c.measured for c in channels], axis=1), references or len(acting)
        window, size = taper(len(values), tapered), np.diff(edges)

        def averaged(lines: np.ndarray) -> np.ndarray:
            sums: np.ndarray = np.add.reduceat(lines[: edges[-1]], edges[:-1], axis=0)
            return sums / size.reshape(-1, *[1] * (lines.ndim - 1))

        gaps = {channel.place: channel for channel in record.calibrated if misses_samples(channel, record)}
        if references and gaps.keys() & {channel.place for channel in channels}:
            samples = [
                Samples.at_own_times(gaps[channel.place], record, window)
                if channel.place in gaps
                else Samples.of_column(channel.measured, window)
                for channel in channels
            ]
            lines = np.stack([[cross_spectrum(a, b) for b in samples[-references:]] for a in samples])
            cross = averaged(np.moveaxis(lines, 2, 0))
            power = averaged(np.stack([x.power() for x in samples], axis=1))
        else:
            lines, cross = _lines(values, window), np.zeros((len(size), len(channels), references), complex)
            for i in range(references):  # one by one: of a million samples all products take gigabytes
                cross[:, :, i] = averaged(lines * lines[:, len(channels) - references + i, None].conj())
            power = averaged(np.abs(lines) ** 2)
        frequency, count = np.fft.rfftfreq(len(values), record.step), independent_part(window) * size
        return CrossSpectra(sensors, acting, values, record.step, averaged(frequency), count, cross, power)

    @cached_property
    def omega(self) -> np.ndarray:
        """(B,), rad/s."""
        return 2.0 * np.pi * self.frequency

    @property
    def shown(self) -> np.ndarray:
        """(N, S), the sensors."""
        return self.values[:, : len(self.sensors)]

    @property
    def orders(self) -> np.ndarray:
        """(S,), see :attr:`Source.order`."""
        return np.array([sensor.order for sensor in self.sensors], dtype=int)

    @cached_property
    def differentiation(self) -> np.ndarray:
        """(B, S), from displacement to what each sensor shows."""
        return (1j * self.omega[:, None]) ** self.orders

    @property
    def density(self) -> np.ndarray:
        """(B, S + F), one-sided power spectral density of every channel, its unit squared per Hz.

        Summed over the frequencies and times their step it is the variance.
        """
        inner = (self.frequency > 0.0) & (2.0 * self.frequency * self.step < 1.0 - 1e-9)
        return np.where(inner, 2.0, 1.0)[:, None] * self.step * self.power

    @cached_property
    def floor(self) -> np.ndarray:
        """(S + F,) power of white noise in every channel, at most."""
        return np.array([lowest_level(column, self.step) for column in self.values.T]) ** 2

    @property
    def of_acting(self) -> np.ndarray:
        """(B, F, F), of what acts."""
        return self.cross[:, len(self.sensors) :, self.cross.shape[2] - len(self.acting) :]

    @property
    def of_both(self) -> np.ndarray:
        """(B, S, F), sensor times conjugate one of what acts."""
        return self.cross[:, : len(self.sensors), self.cross.shape[2] - len(self.acting) :]

    @cached_property
    def response(self) -> np.ndarray:
        """(B, S, F), the sensors' units per those of what acts: the least squares of noise in the sensors."""
        of_acting = np.swapaxes(self.of_acting, 1, 2)
        trace = np.einsum("bff->b", of_acting).real / max(len(self.acting), 1)
        ridge = SPECTRA_RIDGE * np.maximum(trace, trace.max() * 1e-12)
        held = of_acting + ridge[:, None, None] * np.eye(len(self.acting))
        return np.swapaxes(np.linalg.solve(held, np.swapaxes(self.of_both, 1, 2)), 1, 2)

    @cached_property
    def coherence(self) -> np.ndarray:
        """(B, S), 0 to 1, of every sensor with all that acts."""
        explained = np.sum(self.of_both.conj() * self.response, axis=2).real
        power = self.power[:, : len(self.sensors)]
        return np.clip(np.divide(explained, power, out=np.zeros_like(power), where=power > 0.0), 0.0, 1.0)

    def chance_coherence(self, probability: float = 0.01) -> float:
        """Coherence that noise alone exceeds at one frequency with this probability.

        Bendat and Piersol, Random Data, 4th edition, section 9.2.
        """
        return float(1.0 - probability ** (1.0 / (max(float(self.count[0]), 2.0) - 1.0)))

    def smoothing(self, width: float) -> np.ndarray:
        """(O, B), averages over neighbours by a Gaussian of a relative width in frequency; fewer where it is wide."""
        low, high = np.log(self.omega[0]), np.log(self.omega[-1])
        centres = np.linspace(low, high, int(min(len(self.omega), max(8, 2.0 * (high - low) / width))))
        spacing = np.gradient(self.omega) / self.omega
        weights = spacing * np.exp(-0.5 * ((np.log(self.omega) - centres[:, None]) / width) ** 2)
        kept = weights.sum(axis=1) > 0
        return weights[kept] / weights[kept].sum(axis=1, keepdims=True)


def taper(samples: int, part: float = 1.0) -> np.ndarray:
    """(N,), a cosine that takes this part of a record at both ends together (Tukey's window); 1: Hann's."""
    place = np.arange(samples) / (samples - 1)
    return 0.5 - 0.5 * np.cos(2.0 * np.pi * np.minimum(np.minimum(place, place[::-1]) / part, 0.5))


def independent_part(window: np.ndarray) -> float:
    """Independent values over lines of a spectrum under a window (N,), which makes neighbours go together."""
    return float(np.sum(window**2) ** 2 / (len(window) * np.sum(window**4)))


def piece_length(samples: int) -> int:
    """Of a piece of the record, samples."""
    wanted = min(max(samples // PIECES, SHORTEST_PIECE), LONGEST_PIECE)
    return max(16, min(wanted, samples // FEWEST_PIECES))


def band_edges(first: int, stop: int, most: int | None = None) -> list[int]:
    """First lines of groups, from ``first`` to below ``stop``, that are wider the higher they lie; at last ``stop``.

    Their relative width grows until they are no more than ``most``.
    """
    resolution = RELATIVE_RESOLUTION
    while True:
        edges, at = [], first
        while at < stop:
            edges.append(at)
            at += max(1, int(resolution * at))
        if most is None or len(edges) <= most:
            return [*edges, stop]
        resolution *= 1.5


def misses_samples(channel: Channel, record: Record) -> bool:
    """Whether the column of a calibrated channel shows more than its samples do.

    A load cell whose own samples are even is not counted: nothing better is known than that its band ends where these
    can follow it.
    """
    step = channel.even_step
    return step is None or (step > MISSES_NONE * record.step and channel.quantity not in (FORCE, GROUND))


def _lines(values: np.ndarray, window: np.ndarray) -> np.ndarray:
    """(B, C), the spectra of channels (N, C) about their means; white noise of variance s^2 has the power s^2."""
    swing = (values - values.mean(axis=0)) * window[:, None]
    return np.fft.rfft(swing, axis=0) / np.sqrt(np.sum(window**2))


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of one channel under the window of the whole record, transformed over twice its length.

    Attributes:
        values: (N + 1,), of the samples, their mean taken out.
        places: (N + 1,), of the window at the samples.
        window: (N,).
    """

    values: np.ndarray
    places: np.ndarray
    window: np.ndarray

    @classmethod
    def of_column(cls, column: np.ndarray, window: np.ndarray) -> Samples:
        """Of a channel (N,) with a sample at every time."""
        return cls(_doubled((column - column.mean()) * window), _doubled(window), window)

    @classmethod
    def at_own_times(cls, channel: Channel, record: Record, window: np.ndarray) -> Samples:
        """Of a channel, as it is believed to be calibrated, at its own times."""
        count = len(window)
        place, off = channel.places(record.time)
        inside = (place >= 0) & (place < count)
        place, off, corrected = place[inside], off[inside], channel.corrected_samples()[1][inside]
        swing = window[place] * (corrected - np.average(corrected, weights=window[place]))
        turn = -2j * np.pi * np.fft.rfftfreq(2 * count)
        values, term = np.zeros(count + 1, complex), np.ones(count + 1, complex)
        for order in range(PHASE_TERMS):
            values += term * _doubled(np.bincount(place, swing * off**order, minlength=count))
            term = term * turn / (order + 1)
        return cls(values, _doubled(np.bincount(place, window[place], minlength=count)), window)

    def power(self) -> np.ndarray:
        """(N // 2 + 1,) power of the samples, as large in all as that of a complete channel, scatter included."""
        part = self.places[0].real / float(self.window.sum())
        power: np.ndarray = np.abs(_folded(np.fft.irfft(self.values))) ** 2
        return power / (part**2 * np.sum(self.window**2))


def cross_spectrum(a: Samples, b: Samples) -> np.ndarray:
    """(N // 2 + 1,) spectrum of a times the conjugate one of b, of channels that miss no sample but for scatter."""
    products, there, pairs = (
        np.fft.irfft(x)
        for x in (a.values * b.values.conj(), a.places * b.places.conj(), np.abs(_doubled(a.window)) ** 2)
    )
    seen = there > FEWEST_PAIRS * pairs + 1e-9 * pairs[0]
    products = np.where(seen, products * pairs / np.where(seen, there, 1.0), 0.0)
    return _folded(products) / np.sum(a.window**2)


def _doubled(values: np.ndarray) -> np.ndarray:
    """(N + 1,), the transform of (N,) over twice its length."""
    return np.fft.rfft(values, 2 * len(values))


def _folded(doubled: np.ndarray) -> np.ndarray:
    """(N // 2 + 1,), the transform over N of a history (2 N,)."""
    half = len(doubled) // 2
    return np.fft.rfft(doubled[:half] + doubled[half:])
