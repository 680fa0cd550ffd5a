"""Gaussian noise in a band of frequencies, as a sum of sinusoids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.fft import ifft

from pinn_cli.record.excitation.excitation import Excitation, checked_band
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import LARGEST_LEGACY_SEED, LARGEST_WHOLE, one_of, positive_number, whole_number

PHASES = ("random", "authors")
AUTHORS_AMPLITUDE = 500.0  # N; their code's, where the paper says 1.0 N

# Times and sinusoids from which on evenly spaced times are left to a Fourier transform, and how far from even they may
# be, in steps.
MANY_TERMS, UNEVEN = 30_000_000, 1e-6


class BandedNoise(Excitation):
    """f(t) = a sum_k cos(2 pi k t / P + phi_k) over the bins k / P in the band, known at every time.

    Amplitudes are equal and phases uniform, which tends to a Gaussian signal as the bins grow in number.

    Args:
        ndof, duration, samples: Of the chain and the record, see :class:`Excitation`.
        band: [low, high], Hz, both ends included.
        rms: Root mean square over a period P, N. None, with ``phases="authors"`` only: the authors' amplitude, 500 N
            times the inverse FFT of a unit spectrum.
        dofs: The forced DOFs, counted from 1; each has phases of its own.
        seed: Of the phases.
        phases: ``random``: numpy's default generator, one stream per DOF; P is the duration. ``authors``: legacy
            ``RandomState(seed + i)`` for the i-th forced DOF (from 0; theirs is one, with seed 43810), drawn for every
            bin below the Nyquist frequency; P is one sample longer than the duration, as in an FFT.

    Raises:
        InputError: Naming ``excitation.<setting>``; a band above the Nyquist frequency, or one that falls between the
            bins of a short record.
    """

    def __init__(
        self,
        ndof: int,
        duration: float,
        samples: int,
        band: Sequence[float],
        rms: float | None,
        dofs: Sequence[int],
        seed: int = 0,
        phases: Annotated[str, PHASES] = "random",
    ) -> None:
        super().__init__(ndof, duration, samples, dofs)
        self.band = checked_band(band, self.nyquist)
        self.phases = one_of("excitation.phases", phases, PHASES)
        most = LARGEST_LEGACY_SEED if phases == "authors" else LARGEST_WHOLE
        self.seed = whole_number("excitation.seed", seed, most=most)
        self.period = self.duration * (samples / (samples - 1) if phases == "authors" else 1.0)
        self.bins = self._bins_in_band()
        if rms is None and phases == "authors":
            self.amplitude = 2.0 * AUTHORS_AMPLITUDE / samples
        else:
            self.amplitude = positive_number("excitation.rms", rms) * math.sqrt(2.0 / len(self.bins))
        self._coefficients = self.amplitude * np.exp(1j * self._phases())  # (bins, dofs)

    def signals(self, time: np.ndarray) -> np.ndarray:
        """See :meth:`Excitation.signals`."""
        return sum_of_sinusoids(time, self.period, self.bins, self._coefficients)

    def _bins_in_band(self) -> np.ndarray:
        low, high = self.band
        # Of an even number of FFT bins the last is the Nyquist frequency, which has no phase.
        bins = np.arange(1, (self.samples + 1) // 2)
        frequencies = bins / self.period
        bins = bins[(frequencies >= low) & (frequencies <= high)]
        if len(bins) == 0:
            # The next bin enters from above; a little more, so that the four digits shown are not too few.
            longer = 1.001 * (math.floor(self.period * high) + 1) / high * self.duration / self.period
            hint = f"the record is too short for its band; simulation.duration={longer:.4g} would do"
            allowed = f"wide enough to hold a multiple of 1 / duration, {1.0 / self.period:.4g} Hz"
            raise InputError("excitation.band", list(self.band), allowed, hint)
        return np.asarray(bins)

    def _phases(self) -> np.ndarray:
        """(bins, dofs), rad."""
        if self.phases == "authors":
            count = (self.samples - 1) // 2
            drawn = [np.random.RandomState(self.seed + i).rand(count)[self.bins - 1] for i in range(len(self.dofs))]
        else:
            drawn = [np.random.default_rng([self.seed, dof]).random(len(self.bins)) for dof in self.dofs]
        return 2.0 * np.pi * np.stack(drawn, axis=1)


def sum_of_sinusoids(time: np.ndarray, period: float, bins: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Re sum_k c_k exp(2 pi i k t / P), (M, columns), at times (M,), s, of a period P, s.

    Bins k (K,) are whole numbers without gaps; coefficients (K, columns) hold amplitude and phase.
    """
    # With w = exp(2 pi i t / P) the sum is the real part of a polynomial in w. Horner's scheme needs no array of
    # (time, bins) and takes a tenth of the cosines' time, but loops over the bins: at few times, form the powers.
    turn = 2j * np.pi / period
    if len(time) * len(bins) >= MANY_TERMS:
        steps = _steps_in_a_period(time, period)
        if steps > bins[-1]:
            spectrum = np.zeros((steps, coefficients.shape[1]), dtype=np.complex128)
            spectrum[bins] = coefficients * np.exp(turn * time[0] * bins)[:, None]
            whole: np.ndarray = np.real(ifft(spectrum, axis=0, norm="forward"))
            return whole[np.arange(len(time)) % steps]
    if len(time) < len(bins):
        return np.real(np.exp(turn * np.outer(time, bins)) @ coefficients)
    w = np.exp(turn * time)
    return np.real(polyval(w, coefficients) * w ** bins[0]).T


def _steps_in_a_period(time: np.ndarray, period: float) -> int:
    """How many evenly spaced times fill the period; 0 where they are uneven, or do not fill it."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    steps = round(period / step)
    even = np.abs(time - (time[0] + step * np.arange(len(time)))).max() <= UNEVEN * step
    return steps if even and abs(period / step - steps) <= UNEVEN else 0
