"""Lines of the spectrum of a whole record around one place, and what the two kinds of fits have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.system.priors import HALF_WIDTH_90

# A band reaches so many half widths of its mode to either side, and this part of its frequency at most.
HALF_WIDTHS, WIDEST = 10.0, 0.3
# Groups of lines that tell how uncertain a mode is.
GROUPS = 30
# Under Hann's window a tone stands so many times above the median of so many lines to either side, and has this part of
# all power at least; an input acts at tones alone where they have this part together. Below this line there are drifts.
TONE, AROUND_TONE, LEAST_TONE, OF_TONES, LOWEST_TONE = 30.0, 10, 1e-4, 0.9, 4
# What is added to the factor on a variance where a half-power width has one line: measured, see `widened`.
FEW_LINES = 2.0


@dataclass(frozen=True, eq=False)
class Lines:
    """Spectra of channels, without a window.

    Attributes:
        frequency: (B,), Hz, from 0 on.
        outputs: (B, S), sensors.
        inputs: (B, F), what acts.
        step: From sample to sample, s.
        samples: N.
        tones: Frequencies (T,) at which an input acts alone, Hz, one array each; empty of one that fills a band.
    """

    frequency: np.ndarray
    outputs: np.ndarray
    inputs: np.ndarray
    step: float
    samples: int
    tones: Sequence[np.ndarray]

    @classmethod
    def of(cls, outputs: np.ndarray, inputs: np.ndarray, step: float) -> Lines:
        """Of sensors (N, S) and inputs (N, F); white noise of variance s^2 has the power s^2."""
        from scipy.fft import rfft, rfftfreq

        n = len(outputs)
        y, u = (rfft(x - x.mean(axis=0), axis=0) / np.sqrt(n) for x in (outputs, inputs))
        f = rfftfreq(n, step)
        return cls(f, y, u, step, n, [_tones(f, column) for column in u.T])

    @property
    def duration(self) -> float:
        """S."""
        return self.samples * self.step

    def around(self, pole: Pole, fewest: int) -> Lines:
        """Those around a mode, so many at least where the record has them."""
        half = min(max(HALF_WIDTHS * pole.damping * pole.frequency, 0.5 * fewest / self.duration), self.frequency[-1])
        half = max(min(half, WIDEST * pole.frequency), 0.5 * fewest / self.duration)
        first = max(int(np.ceil((pole.frequency - half) * self.duration)), 1)
        last = int((pole.frequency + half) * self.duration)
        last = min(max(last, first + fewest), int(0.98 * len(self.frequency)))
        within = slice(max(1, min(first, last - fewest)), last)
        f, y, u = (lines[within] for lines in (self.frequency, self.outputs, self.inputs))
        return replace(self, frequency=f, outputs=y, inputs=u)

    @property
    def filled(self) -> float:
        """How many lines the weakest input's power fills; of tones these count, however they leak."""
        power, f = np.abs(self.inputs) ** 2, self.frequency
        within = [np.sum((at >= f[0]) & (at <= f[-1])) for at in self.tones]
        filled = power.sum(axis=0) ** 2 / np.maximum(np.sum(power**2, axis=0), 1e-300)
        return float(min([*filled, *(count for count in within if count)]))


def _tones(frequency: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """(T,), see :class:`Lines`, of an input's lines (B,) from 0 on."""
    from scipy.ndimage import median_filter

    power = np.abs(lines[1:-1] - 0.5 * (lines[:-2] + lines[2:])) ** 2
    power, frequency = power[LOWEST_TONE:], frequency[1 + LOWEST_TONE : -1]
    at = np.flatnonzero(power > TONE * median_filter(power, 2 * AROUND_TONE + 1))
    groups = [group for group in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(group)]
    tones = [(np.average(frequency[group], weights=power[group]), power[group].sum()) for group in groups]
    few = power[at].sum() > OF_TONES * power.sum()
    return np.array([f for f, of_tone in tones if few and of_tone > LEAST_TONE * power.sum()])


@dataclass(frozen=True)
class Pole:
    """Of a vibration.

    Attributes:
        frequency: Undamped, Hz.
        damping: Ratio.
    """

    frequency: float
    damping: float

    @property
    def at(self) -> complex:
        """1/s."""
        return 2.0 * np.pi * self.frequency * complex(-self.damping, (1.0 - self.damping**2) ** 0.5)

    @property
    def slopes(self) -> np.ndarray:
        """(2,), of :attr:`at` by the logarithms of frequency and damping ratio."""
        size, zeta = 2.0 * np.pi * self.frequency, self.damping
        return np.array([self.at, size * zeta * complex(-1.0, -zeta / (1.0 - zeta**2) ** 0.5)])

    def moved(self, by: np.ndarray) -> Pole:
        """With these added to the logarithms."""
        return Pole(float(self.frequency * np.exp(by[0])), float(min(self.damping * np.exp(by[1]), 0.9)))


@dataclass(frozen=True, eq=False)
class RecordMode:
    """A mode, as the lines of a band have it.

    Attributes:
        frequency: Undamped, Hz.
        damping: Ratio, 0 to 1.
        covariance: (2, 2), of the logarithms of both.
        shape: (S,), complex, in the sensors' units; the largest is one.
        noise: (S, S), covariance of the errors of its entries, complex.
        explained: Part of the power at its peak, of the sensor that shows it best, that is its own.
    """

    frequency: float
    damping: float
    covariance: np.ndarray
    shape: np.ndarray
    noise: np.ndarray
    explained: float

    @property
    def frequency_std(self) -> float:
        """Hz."""
        return float(self.frequency * self.covariance[0, 0] ** 0.5)

    @property
    def damping_std(self) -> float:
        """Of the ratio, to first order."""
        return float(self.damping * self.covariance[1, 1] ** 0.5)

    @property
    def frequency_interval(self) -> tuple[float, float]:
        """Central 90 %, Hz."""
        return _interval(self.frequency, self.covariance[0, 0])

    @property
    def damping_interval(self) -> tuple[float, float]:
        """Central 90 %; of the logarithm, so that it stays positive."""
        return _interval(self.damping, self.covariance[1, 1])


def _interval(value: float, variance: float) -> tuple[float, float]:
    factor = float(np.exp(HALF_WIDTH_90 * variance**0.5))
    return value / factor, value * factor


def widened(covariance: np.ndarray, pole: Pole, duration: float, factors: tuple[float, float]) -> np.ndarray:
    """A covariance (2, 2) of first order as wide as errors of simulated records were, and wider the fewer lines tell.

    It is of the logarithms of a pole's frequency and damping ratio; the factors are on the variances of both, where a
    half-power width has many lines in the record's duration, s.
    """
    lines = 2.0 * pole.damping * pole.frequency * duration
    factor = np.sqrt(np.array(factors) + FEW_LINES / max(lines, 0.5))
    return np.asarray(covariance * np.outer(factor, factor))


def scatter(scores: np.ndarray) -> np.ndarray:
    """(P, P), covariance of the sum of scores (L, P), one for each line.

    Adjacent lines are a group, whose errors go together (Liang and Zeger, Biometrika 73, 1986). What each of several
    blows sets off is off by a factor of its own, and from line to line that moves a pole to and fro; where power has an
    edge in the band, one side of it moves the pole as a whole.
    """
    of_groups = np.add.reduceat(scores, np.arange(0, len(scores), max(1, len(scores) // GROUPS)), axis=0)
    return np.asarray(of_groups.T @ of_groups)


def normalised(shape: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A shape (S,) whose largest is one, and the covariance (S, S) of its entries at that size."""
    largest = int(np.argmax(np.abs(shape)))
    return shape / (shape[largest] or 1.0), noise / max(abs(shape[largest]), 1e-150) ** 2


def deviations(shape: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(S,), of the real part of a shape (S,) whose largest is one, from the covariance (S, S) of its entries."""
    largest = int(np.argmax(np.abs(shape)))
    of_both = 2.0 * (shape.conj() * noise[largest]).real
    variance = np.diag(noise).real - of_both + np.abs(shape) ** 2 * noise[largest, largest].real
    return np.asarray(np.sqrt(np.maximum(0.5 * variance, 0.0)))
