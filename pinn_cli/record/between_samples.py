"""What a history does between its samples: the one place that says so.

A band-limited history is told by best linear interpolation (kriging; Rasmussen and Williams 2006, section 2.2) of a
process whose power is spread evenly over a band, from the nearest samples. In the middle of a record that is a windowed
sinc series, and exact for all practical purposes. At its ends, where half of the neighbours are missing, a spline
through the samples tells a slow history better: the two are weighed there, and the standard deviation says what is
lost. A held history keeps the value of the sample before. One that goes on by straight lines is put right once, when a
record is read: below its Nyquist frequency it is band-limited.

Records of earthquakes are kept at 50 or 100 values a second, and programs that shake a structure join them by straight
lines. A line's corners have content at all frequencies. Sampled again, what lies above the Nyquist frequency is folded
below it: the samples hold more than what moves the structure, by a tenth at a third of the Nyquist frequency.
"""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar, Literal, get_args

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import cho_factor, cho_solve

from pinn_cli.record.spectrum import lowest_level

# What a record says of its inputs, and what a file may say of them.
Intersample = Literal["band_limited", "zero_order_hold"]
INTERSAMPLE: tuple[str, ...] = get_args(Intersample)
FIRST_ORDER_HOLD = "first_order_hold"
BETWEEN_SAMPLES = (*INTERSAMPLE, FIRST_ORDER_HOLD)
# By the hold of a simulator: see `pinn_cli.record.simulation.HOLDS`.
INTERSAMPLE_OF_HOLD: dict[str, Intersample] = {"exact": "band_limited", "zero_order": "zero_order_hold"}

# Neighbours on either side. A sine at 90 % of the Nyquist frequency is told to 2e-5 of its size with 64 of them, at
# 95 % to 2e-4; fewer are too few for what the band leaves to interpolate with.
REACH = 64
# Least power of a sample that is its own noise, over that of the process: keeps the weights from exploding.
LEAST_NOISE = 1e-7
# Noise over the rms of a history that its ends allow for at most: more would smooth the history.
NOISIEST = 0.1
# The process fills the spectrum up to this part of the sampling rate, whatever the history's own band: the noise
# between the samples is then that of the samples. Closer to one half nothing is left to interpolate with.
USABLE_BAND = 0.475
# A spline goes through so many times as many samples, which kriging tells: it follows a history up to 0.9 of the
# Nyquist frequency to 1e-5. Through the samples themselves it is off by 7e-4 up to half of that frequency, by 6e-3 up
# to 0.65 of it and by a tenth up to 0.9; in the first intervals and the last by some forty times as much. Of white
# noise the two differ by a seventh: a quarter allows for chance.
DENSER, SPLINE_DEGREE, AT_ENDS, OF_NOISE = 4, 5, 40.0, 0.25
# Of a step, by which a time may miss the sample that it belongs to.
STEP_ROUNDING = 1e-6
# Samples per line that are looked for, and the blocks in which it is: so many lines each, the louder half of them.
MOST_PER_LINE, LINES_PER_BLOCK, FEWEST_BLOCKS = 12, 8, 6
# Share of these blocks in which the corners have this part of all curvature.
MOST_BLOCKS, AT_CORNERS = 0.9, 0.75


class BandLimited:
    """A history without content above the Nyquist frequency of its samples (N, ...) at even times (N,), s.

    Of a force most columns are zero as a rule, and stay so. ``hold`` is a simulator's word for it.
    """

    hold: ClassVar[str] = "exact"

    def __init__(self, time: np.ndarray, values: np.ndarray) -> None:
        columns = values.reshape(len(values), -1)
        self.time, self._shape, self._size = time, values.shape[1:], columns.shape[1]
        self._acting = np.flatnonzero(columns.any(axis=0))
        self._spline = dense_spline(time, columns[:, self._acting]) if self._acting.size else None

    def __call__(self, at: np.ndarray) -> np.ndarray:
        """(..., values), at times of any shape, s."""
        out = np.zeros((*np.shape(at), self._size))
        if self._spline is not None:
            out[..., self._acting] = self._spline(at)
        return out.reshape(*np.shape(at), *self._shape)

    def within(self, parts: np.ndarray) -> np.ndarray:
        """(P, N - 1, ...), at parts (P,) of every step, from 0 to 1."""
        return self(self.time[:-1] + parts[:, None] * np.diff(self.time))


class Held:
    """A zero-order hold: the value of each sample (N, ...) until the next one of even times (N,), s."""

    hold: ClassVar[str] = "zero_order"

    def __init__(self, time: np.ndarray, values: np.ndarray) -> None:
        self.time, self.values = time, values

    def __call__(self, at: np.ndarray) -> np.ndarray:
        """(..., values), at times of any shape, s."""
        late = STEP_ROUNDING * (self.time[1] - self.time[0])
        before = np.searchsorted(self.time, np.asarray(at) + late, side="right") - 1
        return np.asarray(self.values[np.maximum(before, 0)])

    def within(self, parts: np.ndarray) -> np.ndarray:
        """(P, N - 1, ...), at parts (P,) of every step, its end included."""
        return np.broadcast_to(self.values[:-1], (len(parts), *self.values[:-1].shape))


def between_samples(time: np.ndarray, values: np.ndarray, intersample: str) -> BandLimited | Held:
    """A history at any time, from its samples (N, ...) at times (N,), s, and what is said of it: one of INTERSAMPLE."""
    return Held(time, values) if intersample == "zero_order_hold" else BandLimited(time, values)


def dense_spline(time: np.ndarray, samples: np.ndarray) -> BSpline:
    """Of band-limited histories (N,) or (N, n) with samples at times (N,), s: it can be integrated, too."""
    dense, _ = refined(samples.reshape(len(samples), -1), DENSER)
    return make_interp_spline(refined_times(time, DENSER), dense.reshape(-1, *samples.shape[1:]), k=SPLINE_DEGREE)


def refined_times(time: np.ndarray, refinement: int) -> np.ndarray:
    """Times (N,) with ``refinement`` - 1 more between any two: ((N - 1) refinement + 1,)."""
    if refinement == 1:
        return time
    last = len(time) - 1
    return np.interp(np.arange(last * refinement + 1) / refinement, np.arange(last + 1), time)


def refined(values: np.ndarray, refinement: int) -> tuple[np.ndarray, np.ndarray]:
    """Band-limited histories (N, n) at :func:`refined_times`, (N', n), and the standard deviation of what is left open.

    At the ends of a record kriging, which takes them to fill the band, knows less of a slow history than the spline
    through the samples. How far that one is off shows in the middle, beside what white noise makes of the two: each
    counts by its variance. Noise that the middle has from the samples is theirs, and is not counted. The samples come
    out unchanged, with a deviation of 0.
    """
    if refinement == 1 or not values.any():
        out = np.repeat(values, refinement, axis=0)[: (len(values) - 1) * refinement + 1]
        return out, np.zeros(out.shape)
    noise = np.array([lowest_level(column, 1.0) for column in values.T])
    power = np.mean(values**2, axis=0)
    # At the ends what takes the samples to be exact makes a step of 40 times their noise.
    part = np.divide(noise, np.sqrt(power), out=np.zeros_like(noise), where=power > 0.0).max()
    dense, spread = _kriged(values, refinement, float(min(part, NOISIEST)))
    samples = np.arange(float(len(values)))
    off = make_interp_spline(samples, values, k=SPLINE_DEGREE)(refined_times(samples, refinement)) - dense
    quarter = len(dense) // 4
    of_spline = AT_ENDS**2 * np.maximum(np.var(off[quarter:-quarter], axis=0) - (OF_NOISE * noise) ** 2, 0.0) + noise**2
    exact, noisy = (np.outer(deviation**2, power) for deviation in spread)
    share = np.divide(exact, exact + of_spline, out=np.zeros_like(dense), where=exact + of_spline > 0.0)
    return dense + share * off, np.sqrt((1.0 - share) ** 2 * noisy + share**2 * of_spline)


def _kriged(values: np.ndarray, refinement: int, noise: float) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """(N', n) histories by kriging alone; (N',) standard deviations over their rms as if exact, and as they are.

    Their ends allow for white noise of the samples (N, n), over their rms.
    """
    samples, width = len(values), min(2 * REACH, len(values))
    exact, noisy = (_weights(width, refinement, max(level**2, LEAST_NOISE)) for level in (0.0, noise))
    places = np.arange(width - 1)
    at_end = np.minimum(places, places[::-1])[:, None] < REACH // 2
    weights, left_open = np.where(at_end[..., None], noisy[0], exact[0]), np.where(at_end, noisy[1], exact[1])
    reach = width // 2
    middle = slice(reach - 1, samples - width + reach)
    between = np.empty((samples - 1, refinement - 1, values.shape[1]))
    between[: middle.start] = weights[: reach - 1] @ values[:width]
    between[middle.stop :] = weights[reach:] @ values[-width:]
    for i, column in enumerate(np.ascontiguousarray(values.T)):
        between[middle, :, i] = np.stack(
            [np.correlate(column, kernel, "valid") for kernel in weights[reach - 1]], axis=1
        )
    out = np.repeat(values, refinement, axis=0)[: (samples - 1) * refinement + 1]
    spread = np.zeros((2, len(out)))
    place = np.concatenate((places[: reach - 1], np.full(samples - width + 1, reach - 1), places[reach:]))
    for part in range(1, refinement):
        out[part::refinement] = between[:, part - 1]
        spread[:, part::refinement] = exact[1][place, part - 1], left_open[place, part - 1]
    return out, (spread[0], spread[1])


@lru_cache(maxsize=32)
def _weights(width: int, refinement: int, nugget: float) -> tuple[np.ndarray, np.ndarray]:
    """(width - 1, refinement - 1, width), of all samples in the values between any two, and what they leave open.

    That is (width - 1, refinement - 1) standard deviations over the rms of the process. The nugget is the variance of a
    sample's own noise over that of the process.
    """
    parts = np.arange(1, refinement) / refinement
    weights, variance = _predicted_from(width, nugget, np.arange(width - 1)[:, None] + parts)
    # In the middle of a long record next to nothing is left open but the samples' own noise.
    variance = variance - _predicted_from(2 * REACH, nugget, REACH - 1 + parts)[1]
    # What is most probable of a noisy history is smaller than it. Here it keeps the size of the samples: else inputs
    # would be too small, by a per cent at 20 dB.
    return (1.0 + 2.0 * USABLE_BAND * nugget) * weights, np.sqrt(np.maximum(variance, 0.0))


def _predicted_from(width: int, nugget: float, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., width) weights of so many samples at places (...) among them, and (...) the variance that they leave."""
    samples = np.arange(width, dtype=float)
    factor = cho_factor(_correlation(samples[:, None] - samples) + nugget * np.eye(width))
    correlation = _correlation(places[..., None] - samples)
    weights = cho_solve(factor, correlation.reshape(-1, width).T).T.reshape(correlation.shape)
    return weights, 1.0 - np.sum(weights * correlation, axis=-1)


def _correlation(lag: np.ndarray) -> np.ndarray:
    """Of a process with an even spectrum up to `USABLE_BAND`, by lag in samples."""
    return np.asarray(np.sinc(2.0 * USABLE_BAND * lag))


def held_by_lines(values: np.ndarray) -> np.ndarray:
    """(N,), what straight lines between samples (N,) hold below the Nyquist frequency, at the samples.

    A line's spectrum is that of its samples times sinc^2 (f step), whatever longer lines these lie on. Beyond its ends
    the record goes on as its own odd reflection, as in :func:`pinn_cli.record.spectrum.decimate`.
    """
    before, after = 2.0 * values[0] - values[:0:-1], 2.0 * values[-1] - values[-2::-1]
    longer = np.concatenate((before, values, after))
    filtered = np.fft.irfft(np.fft.rfft(longer) * np.sinc(np.fft.rfftfreq(len(longer))) ** 2, len(longer))
    return np.asarray(filtered[len(before) : len(before) + len(values)])


def samples_per_line(values: np.ndarray) -> int:
    """Of how many samples the straight lines are on which samples (N,) lie; 1 where they lie on none.

    Their second difference is then noise but for every so manieth sample, a corner.
    """
    curvature = np.square(np.diff(values, 2))
    for length in range(2, MOST_PER_LINE + 1):
        size = length * LINES_PER_BLOCK
        blocks = curvature[: len(curvature) // size * size].reshape(-1, LINES_PER_BLOCK, length).sum(axis=1)
        blocks = blocks[np.argsort(blocks.sum(axis=1))[len(blocks) // 2 :]]
        if len(blocks) < FEWEST_BLOCKS or not blocks.any():
            break
        corners = blocks[:, np.argmax(blocks.sum(axis=0))]
        if np.mean(corners >= AT_CORNERS * blocks.sum(axis=1)) >= MOST_BLOCKS:
            return length
    return 1


def evenly_spaced(available: int, count: int) -> np.ndarray:
    """(count,) indices of ``available`` samples, spread evenly, the first and the last included."""
    return np.linspace(0, available - 1, count).round().astype(np.int64)
