"""Spectra of measured channels: their band and white noise, read off a periodogram; and filters for all channels alike.

What one filter leaves of every channel obeys the same linear equations as before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number

# Anti-alias filters leave little above 80 % of the Nyquist frequency; noise read there would come out too small.
USABLE_NYQUIST_FRACTION = 0.8
# Content 70 dB below a channel's mean square does not count as signal: a noise-free record has no band otherwise.
FINEST_FLOOR = 1e-7
AVERAGED_PIECES = 8
# Pieces of a record, side by side, each of which may hold what its whole spectrum does not show: few, more, many; how
# many times as many of them overlap, and their least length.
LOCAL_PIECES, OVERLAPPING, SHORTEST_LOCAL = (8, 32, 128), 4, 64
# Power of the Hann window for a piece, so that a line of it is nothing, 60 dB down, beyond so many beside it; and how
# many times its noise that must be which only a piece shows, since there are many of them.
SHARPER, LINE_WIDTH, LOUD = 3, 6, 10.0
# Parts of a spectrum among which its emptiest is looked for; the Hann window spreads a mean over the lowest bins.
SPECTRUM_PARTS, LOWEST_BINS = 16, 2
# Lines next to zero frequency whose power says how far a mean may be off.
LOW_LINES = 8
# Narrow parts of a spectrum, of so many frequencies at least; one that has so little of the upper half's power shows
# that content reaches there.
NARROW_PARTS, FEWEST_IN_NARROW, FAR_BELOW = 32, 8, 0.1
# Fewer bins above a band are no floor, and neither is more than this part of a channel's power: a signal that fills the
# spectrum evenly looks like that.
FEWEST_BINS, MOST_OF_POWER = 12, 0.5
# What lies outside the band and its flanks is smaller by so many decibels.
ATTENUATION_DB = 60.0
# A flank is this part of the band wide, and at most this part of the lower edge; where the record is short, as wide as
# a filter takes whose half is this part of it.
FLANK, FLANK_OF_EDGE, HALF_OF_RECORD = 0.25, 0.5, 0.1
# Kaiser's: length of a filter times the width of its flanks, at that attenuation.
LENGTH_BY_WIDTH = (ATTENUATION_DB - 7.95) / 14.36
# The samples that are kept have their Nyquist frequency above the upper flank by this factor.
NYQUIST_OVER_BAND = 1.25

# Half the filter's length in samples of the result, as in scipy.signal.decimate.
HALF_LENGTH = 10


def periodogram(x: np.ndarray, step: float, sharper: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and periodogram of a channel (..., N); white noise of variance s^2 reads s^2.

    The window is Hann's, or a power of it, whose lines are wider and leak less.
    """
    samples = x.shape[-1]
    window = np.hanning(samples) ** sharper
    spectrum = np.fft.rfft((x - x.mean(axis=-1, keepdims=True)) * window)
    return np.fft.rfftfreq(samples, step), np.abs(spectrum) ** 2 / np.sum(window**2)


def usable_periodogram(x: np.ndarray, step: float, sharper: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The same up to where anti-alias filters may begin."""
    frequency, power = periodogram(x, step, sharper)
    usable = frequency <= USABLE_NYQUIST_FRACTION * frequency[-1]
    return frequency[usable], power[..., usable]


def signal_band(x: np.ndarray, step: float) -> float:
    """Frequency up to which keeping a channel's content removes more error than the noise that comes with it, Hz.

    Cutting at f leaves out the signal power above f and lets through the noise power below it; their sum is least where
    the cumulative sum of (2 floor - periodogram) is, and that needs no threshold and no smoothing. The floor is the
    median of the upper half of the usable spectrum, which a signal that is oversampled twice leaves to the noise. Of a
    few hundred samples it comes out at half its value once in a while (257: in one channel of 300), and then all of
    that noise would pass for signal: what reaches into the half that the floor is read from must be three floors high.

    What decays soon after a record begins, or acts for a short while, is little beside the noise of the whole record,
    and nothing under the end of a window: any piece of the record may reach further than the whole, by more than the
    width of its lines.
    """
    frequency, power = usable_periodogram(x, step)
    floor = _noise_floor(power)
    last = _last_above(power, 2.0 * floor)
    band = frequency[last if last < len(power) // 2 else _last_above(power, 3.0 * floor)]
    for length in (len(x) // parts for parts in LOCAL_PIECES if len(x) >= parts * SHORTEST_LOCAL):
        frequency, power = usable_periodogram(pieces(x, length), step, SHARPER)
        last = _last_above(power, LOUD * np.maximum(floor, _noise_floor(power)))
        band = max(band, frequency[max(last - LINE_WIDTH, 0)])
    return float(band)


def pieces(x: np.ndarray, length: int) -> np.ndarray:
    """(P, L), overlapping pieces of a history (N,), so many samples long; or it is one."""
    length = min(length, len(x))
    return np.lib.stride_tricks.sliding_window_view(x, length)[:: max(length // OVERLAPPING, 1)]


def _last_above(power: np.ndarray, level: np.ndarray) -> int:
    """The last line of any periodogram (..., B) that adds more than its level (...); see :func:`signal_band`."""
    return int(np.max(np.argmin(np.cumsum(level[..., None] - power, axis=-1), axis=-1)))


def signal_edges(x: np.ndarray, step: float) -> tuple[float, float]:
    """Frequencies between which one channel (N,) stands out of its noise, Hz; NaN where it does so nowhere.

    The upper one is :func:`signal_band`'s. The lower one likewise: leaving out what is below it removes more noise than
    signal.
    """
    high = signal_band(x, step)
    frequency, power = usable_periodogram(x, step)
    if not high > 0.0 or not power.any():
        return np.nan, np.nan
    gained = np.cumsum(power[frequency <= high] - 2.0 * _noise_floor(power))
    # The mean is taken out before, so the first frequency has no content of its own.
    first = max(int(np.argmin(np.concatenate(([0.0], gained[:-1])))), 1)
    return float(frequency[first]), high


def band_share(x: np.ndarray, step: float, low: float, high: float) -> float:
    """Share of the power of one channel (N,) about its mean between two frequencies (Hz); 0 where they are NaN."""
    frequency, power = periodogram(x, step)
    total = float(power.sum())
    within = (frequency >= low) & (frequency <= high)
    return float(power[within].sum()) / total if total > 0.0 else 0.0


def _noise_floor(power: np.ndarray) -> np.ndarray:
    """(...), mean square of the white noise that the upper half of a usable periodogram (..., B) shows."""
    lines = power.shape[-1]
    floor = np.median(power[..., lines // 2 :], axis=-1) / np.log(2.0)
    parts = np.array_split(power, max(1, min(NARROW_PARTS, lines // FEWEST_IN_NARROW)), axis=-1)
    emptiest = np.min([part.mean(axis=-1) for part in parts], axis=0)
    # Far less anywhere than in the upper half: content fills the half that the floor is read from.
    shown = np.where(emptiest < FAR_BELOW * floor, emptiest, floor)
    return np.maximum(shown, FINEST_FLOOR * power.mean(axis=-1))


def mean_deviation(x: np.ndarray) -> float:
    """Standard deviation of the mean of a channel (N,), as its lowest frequencies have it."""
    power = periodogram(x, 1.0)[1][LOWEST_BINS : LOWEST_BINS + LOW_LINES]
    return float(np.sqrt(np.mean(power) / len(x)))


def white_level(residual: np.ndarray, step: float, above: float) -> float:
    """Standard deviation of the white noise of a residual (N,), read above a frequency (Hz)."""
    frequency, power = usable_periodogram(residual, step)
    return float(np.sqrt(np.mean(power[frequency > min(above, 0.9 * frequency[-1])])))


def noise_level(x: np.ndarray, step: float) -> float:
    """Standard deviation of the white noise that a channel (N,) shows, see :func:`signal_band`."""
    return float(_noise_floor(usable_periodogram(x, step)[1]) ** 0.5)


def lowest_level(x: np.ndarray, step: float) -> float:
    """Standard deviation that white noise of a channel (N,) has at most: that of the emptiest part of its spectrum.

    Whatever else a channel holds adds to its noise, so the least mean power of any of `SPECTRUM_PARTS` parts of the
    usable spectrum bounds it from above, but for the scatter of that mean.
    """
    usable = usable_periodogram(x, step)[1][LOWEST_BINS:]
    return float(np.sqrt(min(np.mean(part) for part in np.array_split(usable, min(SPECTRUM_PARTS, len(usable))))))


def visible_floor(x: np.ndarray, step: float) -> float | None:
    """Standard deviation of the white noise that a channel (N,) shows above its band; None where it shows none.

    What lies above the band passes for noise if its lower half has the power of its upper half, within a quarter and
    what chance allows.
    """
    frequency, power = usable_periodogram(x, step)
    above = power[frequency > signal_band(x, step)][LOWEST_BINS:]
    if len(above) < FEWEST_BINS:
        return None
    lower, upper = np.array_split(above, 2)
    chance = _by_chance(lower, upper)
    if upper.mean() <= 0 or abs(np.log(lower.mean() / upper.mean())) > np.log(1.25) + chance:
        return None
    if above.mean() > MOST_OF_POWER * periodogram(x, step)[1].mean():
        return None
    return float(np.sqrt(above.mean()))


def level_at_end(x: np.ndarray, step: float) -> float | None:
    """Standard deviation that white noise has at most by the last tenth below the Nyquist frequency of a channel (N,).

    None unless that is far less than what lies before: a filter lets no more through, or content ends only there.
    """
    before, _, last = _upper_parts(x, step)
    if len(last) < FEWEST_BINS or not last.mean() < FAR_BELOW * before.mean():
        return None
    return float(np.sqrt(last.mean()))


def reaches_nyquist(x: np.ndarray, step: float, noise: float = 0.0) -> bool:
    """Whether a channel (N,) has content up to its Nyquist frequency, with power that falls off in the last parts.

    White noise, whose standard deviation somebody may know, has as much between 0.8 and 1 of the Nyquist frequency as
    between 0.6 and 0.8, but for chance; in most of the uppermost tenth of a channel whose content ends below it there
    is nothing else; and what stops to fall is noise, whatever its level.
    """
    lower, upper, last = _upper_parts(x, step)
    if min(len(lower), len(last)) < FEWEST_BINS or not upper.any():
        return False
    fall, first = np.log(lower.mean() / upper.mean()), upper[: len(upper) - len(last)]
    falls = fall > _by_chance(lower, upper)
    # By a power of the frequency from the middle of one part to that of the other, and then within the upper one.
    steady = fall * np.log(0.95 / 0.85) / np.log(0.9 / 0.7)
    falls &= np.log(first.mean() / last.mean()) > steady - _by_chance(first, last)
    return bool(falls and np.median(last) / np.log(2.0) > noise**2 * (1.0 + 3.0 / np.sqrt(len(last))))


def _upper_parts(x: np.ndarray, step: float) -> list[np.ndarray]:
    """Power of a channel (N,) from 0.6 to 0.8, from 0.8 to 1 and from 0.9 to 1 of its Nyquist frequency."""
    frequency, power = periodogram(x, step)
    return [
        power[(frequency > low * frequency[-1]) & (frequency <= high * frequency[-1])]
        for low, high in ((0.6, USABLE_NYQUIST_FRACTION), (USABLE_NYQUIST_FRACTION, 1.0), (0.9, 1.0))
    ]


def _by_chance(lower: np.ndarray, upper: np.ndarray) -> float:
    """How far the logarithm of the ratio of the mean powers of two parts of one noise may lie from 0."""
    return float(3.0 * np.sqrt(1.0 / len(lower) + 1.0 / len(upper)))


def occupied_band(residual: np.ndarray, step: float, top: float) -> float:
    """Share of the band up to ``top`` (Hz) that histories (N, n) fill, together; 1 when they are white, or none."""
    # Averaging over pieces steadies the periodogram, whose own scatter would pass for colour.
    length = min(max(16, len(residual) // AVERAGED_PIECES), len(residual))
    if residual.shape[1] == 0 or length < FEWEST_BINS:
        return 1.0
    pieces = [column[i : i + length] for column in residual.T for i in range(0, len(column) - length + 1, length)]
    frequency, _ = periodogram(pieces[0], step)
    power = np.mean([periodogram(piece, step)[1] for piece in pieces], axis=0)
    below = power[(frequency <= top) & (frequency > 0)]
    if len(below) == 0 or not below.any():
        return 1.0
    return float(below.sum() ** 2 / (len(below) * np.sum(below**2)))


@dataclass(frozen=True, eq=False)
class BandPass:
    """A filter without phase, and how many of the samples behind it are enough.

    Structures are linear, or all but: force and response behind one filter obey the equation of motion that they did
    before. The filter is finite, and what is not reached by it whole is left out: nothing is said of samples beyond
    the ends.

    Attributes:
        taps: (2 half + 1,).
        factor: Every so manieth sample is kept.
        edges: Of the band, Hz.
        step: Of the samples that it filters, s.
    """

    taps: np.ndarray
    factor: int
    edges: tuple[float, float]
    step: float

    @property
    def half(self) -> int:
        """Samples that it takes at either side."""
        return len(self.taps) // 2

    @classmethod
    def of(cls, band: tuple[float, float], samples: int, step: float) -> BandPass:
        """Of a band, Hz, for so many samples; one beyond the Nyquist frequency is refused (``data.band``)."""
        from scipy.signal import firwin

        (low, high), nyquist = band, 0.5 / step
        width = max(
            min(FLANK * (high - low), FLANK_OF_EDGE * low), 0.5 * LENGTH_BY_WIDTH / (HALF_OF_RECORD * samples * step)
        )
        if high + width >= nyquist or width >= low:
            allowed = f"such that it and flanks of {width:.3g} Hz lie between 0 and {nyquist:.4g} Hz"
            hint = "half the sampling rate; a shorter record takes wider flanks"
            raise InputError("data.band", list(band), allowed, hint)
        half = int(np.ceil(0.5 * LENGTH_BY_WIDTH / (width * step)))
        edges = [low - 0.5 * width, high + 0.5 * width]
        taps = firwin(
            2 * half + 1, edges, window=("kaiser", 0.1102 * (ATTENUATION_DB - 8.7)), pass_zero=False, fs=1 / step
        )
        return cls(taps, max(1, int(nyquist / (NYQUIST_OVER_BAND * (high + width)))), band, step)

    def gain(self, frequency: np.ndarray) -> np.ndarray:
        """(F,), what it leaves of an amplitude at each frequency, Hz."""
        from scipy.signal import freqz

        return np.abs(freqz(self.taps, worN=frequency, fs=1.0 / self.step)[1])

    def filtered(self, values: np.ndarray) -> np.ndarray:
        """(M, columns) of (N, columns): from sample ``half`` on, every ``factor``-th, all but the last ``half``."""
        from scipy.signal import oaconvolve

        values = values - values.mean(axis=0)  # gravity is larger than what the filter leaves of it may be
        return oaconvolve(values, self.taps[:, None], mode="valid", axes=0)[:: self.factor]


def checked_band(given: Any) -> tuple[float, float] | None:
    """``data.band`` as a pair of frequencies that grow, Hz, else it is refused; None where it is null."""
    if given is None:
        return None
    edges = entries(given) if isinstance(given, Sequence) and not isinstance(given, str) else []
    if len(edges) != 2 or not all(is_finite_number(x) and x > 0 for x in edges) or not edges[0] < edges[1]:
        raise InputError("data.band", given, "null, or two frequencies in Hz that grow, such as [4, 12]")
    return float(edges[0]), float(edges[1])


def decimate(values: np.ndarray, factor: int) -> np.ndarray:
    """Every ``factor``-th sample of finite (N, columns), after a zero-phase low-pass filter that is the same for all.

    The filter is a Hamming-windowed sinc that halves the amplitude at the new Nyquist frequency and is flat below 0.8
    of it, so that white noise stays nearly white. All columns of a record must go through it: force and response are
    then filtered alike and obey the same linear equation of motion as before.

    Beyond its ends a column goes on as its own odd reflection about the end sample, which keeps value and slope. On the
    Cristallo records (factor 4, windows cut from the middle) the ten samples at either end then miss what the whole
    record gives by 0.1 to 1 % of the signal's rms; zeros beyond the ends, as scipy.signal.decimate has them, by 50 %.
    """
    if factor == 1:
        return values
    from scipy.signal import firwin, resample_poly

    low_pass = firwin(2 * HALF_LENGTH * factor + 1, 1.0 / factor)
    return np.asarray(resample_poly(values, 1, factor, axis=0, window=low_pass, padtype="antireflect"))
