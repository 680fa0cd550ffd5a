"""An artificial earthquake: filtered noise under an envelope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinn_cli.record.excitation.banded_noise import sum_of_sinusoids
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import non_negative_number, positive_number, whole_number


@dataclass(frozen=True)
class Spectrum:
    """The power spectrum of Clough and Penzien (Dynamics of Structures, 1975, section 28-4).

    White noise of the bedrock passes the ground, a damped oscillator (Kanai 1957, Tajimi 1960), and a second one that
    takes away the lowest frequencies, where the ground would drift.

    Attributes:
        ground_frequency, ground_damping: Of the ground, Hz and part of the critical one.
        high_pass, high_pass_damping: Of the second oscillator; Hz, 0: none.

    Raises:
        InputError: Naming ``excitation.<setting>``.
    """

    ground_frequency: float
    ground_damping: float
    high_pass: float
    high_pass_damping: float

    def __post_init__(self) -> None:
        for name in ("ground_frequency", "ground_damping", "high_pass_damping"):
            positive_number(f"excitation.{name}", getattr(self, name))
        non_negative_number("excitation.high_pass", self.high_pass)
        if self.high_pass >= self.ground_frequency:
            allowed = f"below excitation.ground_frequency={self.ground_frequency}, or 0 for none"
            raise InputError("excitation.high_pass", self.high_pass, allowed)

    def __call__(self, frequency: np.ndarray) -> np.ndarray:
        """Power at frequencies (K,), Hz, over that of the bedrock."""
        x = (frequency / self.ground_frequency) ** 2
        damped = 4.0 * self.ground_damping**2 * x
        power = (1.0 + damped) / ((1.0 - x) ** 2 + damped)
        if self.high_pass > 0.0:
            y = (frequency / self.high_pass) ** 2
            power = power * y**2 / ((1.0 - y) ** 2 + 4.0 * self.high_pass_damping**2 * y)
        return np.asarray(power)


@dataclass(frozen=True)
class Envelope:
    """How strong a motion is over time (Jennings, Housner and Tsai 1968): (t / rise)^2, then 1, then exp(-t / decay).

    Attributes:
        rise: s, 0: it begins with its full strength.
        strong: s, of the strong phase.
        decay: s, in which it falls to 1 / e.

    Raises:
        InputError: Naming ``excitation.<setting>``.
    """

    rise: float
    strong: float
    decay: float

    def __post_init__(self) -> None:
        non_negative_number("excitation.rise", self.rise)
        non_negative_number("excitation.strong", self.strong)
        positive_number("excitation.decay", self.decay)

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """(M,), 0 to 1, at times (M,), s; 0 before 0."""
        rising = np.clip(time / self.rise, 0.0, 1.0) ** 2 if self.rise > 0.0 else np.where(time >= 0.0, 1.0, 0.0)
        return np.asarray(rising * np.exp(-np.maximum(time - self.rise - self.strong, 0.0) / self.decay))


class FilteredNoise:
    """a(t) = envelope(t) sum_k A_k cos(2 pi k t / T + phi_k), with A_k^2 / 2 = S(k / T) / T: known at every time.

    Phases are random, so that the sum tends to Gaussian noise of the spectrum S (Shinozuka and Deodatis 1991).

    Args:
        duration: T, s.
        highest: Frequency of the last sinusoid, Hz.
        spectrum: S.
        envelope: Of the motion.
        seed: Of the phases.

    Raises:
        InputError: Naming ``excitation.<setting>``.
    """

    def __init__(self, duration: float, highest: float, spectrum: Spectrum, envelope: Envelope, seed: int) -> None:
        whole_number("excitation.seed", seed)
        self.duration, self.envelope = duration, envelope
        self.bins = np.arange(1, int(np.floor(duration * highest)) + 1)
        if len(self.bins) == 0 or highest < spectrum.ground_frequency:
            allowed = f"above excitation.ground_frequency={spectrum.ground_frequency} and 1 / duration"
            raise InputError("excitation.highest", highest, allowed, "more simulation.samples allow a higher one")
        power = spectrum(self.bins / duration)
        phases = 2.0 * np.pi * np.random.default_rng([seed]).random(len(self.bins))
        # A root mean square of 1 in the strong phase.
        self._coefficients = (np.sqrt(2.0 * power / power.sum()) * np.exp(1j * phases))[:, None]

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """(M,) at times (M,), s; root mean square of the strong phase: 1."""
        stationary = sum_of_sinusoids(time, self.duration, self.bins, self._coefficients)[:, 0]
        return np.asarray(self.envelope(time) * stationary)
