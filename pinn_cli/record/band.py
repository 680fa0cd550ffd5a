"""Filters that go through every channel of a record alike, so that what they leave obeys the same equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number

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
        """Of a band, Hz, for so many samples.

        Raises:
            InputError: Naming ``data.band``: it reaches beyond the Nyquist frequency.
        """
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

        found: np.ndarray = np.abs(freqz(self.taps, worN=frequency, fs=1.0 / self.step)[1])
        return found

    def filtered(self, values: np.ndarray) -> np.ndarray:
        """(M, columns) of (N, columns): from sample ``half`` on, every ``factor``-th, all but the last ``half``."""
        from scipy.signal import oaconvolve

        values = values - values.mean(axis=0)  # gravity is larger than what the filter leaves of it may be
        found: np.ndarray = oaconvolve(values, self.taps[:, None], mode="valid", axes=0)[:: self.factor]
        return found


def checked_band(given: Any) -> tuple[float, float] | None:
    """``data.band`` as a pair, Hz; None where it is null.

    Raises:
        InputError: It is no pair of frequencies that grow.
    """
    if given is None:
        return None
    edges = entries(given) if isinstance(given, Sequence) and not isinstance(given, str) else []
    if len(edges) != 2 or not all(is_finite_number(x) and x > 0 for x in edges) or not edges[0] < edges[1]:
        raise InputError("data.band", given, "null, or two frequencies in Hz that grow, such as [4, 12]")
    return float(edges[0]), float(edges[1])


def decimate(values: np.ndarray, factor: int) -> np.ndarray:
    """Every ``factor``-th sample, after a zero-phase low-pass filter that is the same for every column.

    The filter is a Hamming-windowed sinc that halves the amplitude at the new Nyquist frequency and is flat below 0.8
    of it, so that white noise stays nearly white. All columns of a record must go through it: force and response are
    then filtered alike and obey the same linear equation of motion as before.

    Beyond its ends a column goes on as its own odd reflection about the end sample, which keeps value and slope. On the
    Cristallo records (factor 4, windows cut from the middle) the ten samples at either end then miss what the whole
    record gives by 0.1 to 1 % of the signal's rms; zeros beyond the ends, as scipy.signal.decimate has them, by 50 %.

    Args:
        values: (N, columns), finite.
        factor: >= 1.

    Returns:
        (ceil(N / factor), columns).
    """
    if factor == 1:
        return values
    from scipy.signal import firwin, resample_poly

    low_pass = firwin(2 * HALF_LENGTH * factor + 1, 1.0 / factor)
    return np.asarray(resample_poly(values, 1, factor, axis=0, window=low_pass, padtype="antireflect"))
