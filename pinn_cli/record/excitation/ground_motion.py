"""An earthquake: the ground moves, as it was recorded or as filtered noise under an envelope."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pinn_cli.record.excitation.banded_noise import BandedNoise, sum_of_sinusoids
from pinn_cli.record.excitation.excitation import Excitation
from pinn_cli.record.files.file_format import read_text
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import (
    LARGEST,
    finite_number,
    located,
    non_negative_number,
    positive_number,
    whole_number,
)

log = logging.getLogger(__name__)

# m/s^2, of filtered noise, and the part of the record's Nyquist frequency that it reaches, unless it is said.
DEFAULT_PEAK, DEFAULT_HIGHEST = 3.0, 0.5
# Power of a recorded motion above the record's Nyquist frequency that is worth a word.
TOLD_POWER = 1e-4
# Between the samples the motion is that of its own sinusoids, up to the Nyquist frequency: by FFT at times so many
# times as dense, and by a spline of this degree between those (error below 1e-6 of the highest sinusoid). Zeros on
# either side keep the end of the record from its beginning. Of a measured history nobody knows that it is zero beyond
# its ends: `pinn_cli.record.between_samples` takes nothing of the kind for granted, and tells less (1e-5).
OVERSAMPLING, SPLINE_DEGREE, ZEROS = 16, 5, 256
# Times are printed with few digits: let each be off the regular axis by this part of a step.
AXIS_TOLERANCE = 0.1
_SEPARATOR = re.compile(r"[,;\s]+")
MOTION_SETTING = "excitation.path"
# Of a line that is told, characters.
SHOWN = 60


class GroundMotion(Excitation):
    """The acceleration of the ground: that of a file, or filtered noise under an envelope; known at every time.

    Args:
        ndof, duration, samples: Of the structure and the record, see :class:`Excitation`.
        path: Of a recorded motion, see :meth:`RecordedMotion.read`; a relative one starts at ``base``. None: filtered
            noise (:class:`FilteredNoise`).
        step: s, between the values of a file without times.
        scale: m/s^2, what one unit of the file is; 9.81 where the file is in g.
        peak: m/s^2, the largest acceleration at the record's samples.
        rms: m/s^2, root mean square: of filtered noise in its strong phase (expected), of a file over its length. At
            most one of peak and rms is given. None of them: a file as it is, filtered noise with a peak of 3 m/s^2.
        ground_frequency, ground_damping, high_pass, high_pass_damping: See :class:`Spectrum`.
        highest: Highest frequency of filtered noise, Hz; None: half the Nyquist frequency of the record.
        rise, strong, decay: See :class:`Envelope`.
        seed: Of the phases.
        force: Settings of a :class:`BandedNoise` that acts as well; None: no external force.
        base: The directory the user started the command in; None: the current one.

    Raises:
        InputError: Naming ``excitation.<setting>``.
    """

    needs_force: ClassVar[bool] = False

    def __init__(
        self,
        ndof: int,
        duration: float,
        samples: int,
        path: str | None = None,
        step: float | None = None,
        scale: float = 1.0,
        peak: float | None = None,
        rms: float | None = None,
        ground_frequency: float = 2.5,
        ground_damping: float = 0.6,
        high_pass: float = 0.25,
        high_pass_damping: float = 0.6,
        highest: float | None = None,
        rise: float = 4.0,
        strong: float = 15.0,
        decay: float = 10.0,
        seed: int = 0,
        force: Mapping[str, Any] | None = None,
        base: Path | None = None,
    ) -> None:
        self.acting = None if force is None else _acting(force, ndof, duration, samples)
        super().__init__(ndof, duration, samples, () if self.acting is None else self.acting.dofs)
        if peak is not None and rms is not None:
            raise InputError("excitation.rms", rms, f"null with excitation.peak={peak}", "one of them is the scale")
        motion: FilteredNoise | RecordedMotion
        if path is None:
            spectrum = Spectrum(ground_frequency, ground_damping, high_pass, high_pass_damping)
            highest = (
                DEFAULT_HIGHEST * self.nyquist if highest is None else positive_number("excitation.highest", highest)
            )
            if highest > self.nyquist:
                allowed = f"at most the Nyquist frequency of the record, {self.nyquist:.4g} Hz"
                raise InputError("excitation.highest", highest, allowed, "take more simulation.samples")
            motion = FilteredNoise(self.duration, highest, spectrum, Envelope(rise, strong, decay), seed)
            unscaled, strength = DEFAULT_PEAK if rms is None else None, 1.0
        else:
            if not isinstance(path, str) or not path:
                raise InputError("excitation.path", path, "null or a text file")
            motion = RecordedMotion.read(located(path, base), step)
            self._tell_differences(motion, path)
            if motion.in_g and scale == 1.0 and peak is None and rms is None:
                log.warning("%s says that it is in g: excitation.scale=9.80665 makes m/s^2 of it", Path(path).name)
            unscaled, strength = None, float(np.sqrt(np.mean(motion.samples**2)))
        self._motion = motion
        self.factor = self._factor(scale, unscaled if peak is None else peak, rms, strength)

    @property
    def ground(self) -> Callable[[np.ndarray], np.ndarray]:
        """See :attr:`Excitation.ground`."""
        return lambda time: np.asarray(self.factor * self._motion(np.asarray(time, dtype=np.float64)))

    def signals(self, time: np.ndarray) -> np.ndarray:
        """See :meth:`Excitation.signals`."""
        return np.zeros((len(time), 0)) if self.acting is None else self.acting.signals(time)

    def _factor(self, scale: float, peak: float | None, rms: float | None, strength: float) -> float:
        """By which the motion is multiplied."""
        if finite_number("excitation.scale", scale) == 0.0:
            raise InputError("excitation.scale", scale, "a number other than 0")
        if peak is not None:
            largest = float(np.max(np.abs(self._motion(np.linspace(0.0, self.duration, self.samples)))))
            if not largest > 0.0:
                raise InputError("simulation.duration", self.duration, "long enough for the ground to move")
            return positive_number("excitation.peak", peak) / largest
        return float(scale) if rms is None else positive_number("excitation.rms", rms) / strength

    def _tell_differences(self, motion: RecordedMotion, path: str) -> None:
        """What of a recorded motion the record has not, or the other way round."""
        name, above = Path(path).name, motion.power_above(self.nyquist)
        if motion.duration != self.duration:
            log.info("%s lasts %.4g s, simulation.duration=%.4g", name, motion.duration, self.duration)
        if above > TOLD_POWER:
            text = "%.2g %% of the power of %s lies above the record's Nyquist frequency: take more simulation.samples"
            log.warning(text, 100.0 * above, name)


def _acting(force: Mapping[str, Any], ndof: int, duration: float, samples: int) -> BandedNoise:
    if not isinstance(force, Mapping) or not {"band", "rms", "dofs"} <= set(force) <= {"band", "rms", "dofs", "seed"}:
        hint = "e.g. excitation.force={band: [0.5, 10], rms: 100, dofs: [3], seed: 0}"
        raise InputError("excitation.force", force, "null, or band, rms, dofs and perhaps seed of a banded noise", hint)
    return BandedNoise(ndof, duration, samples, **force)


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


class RecordedMotion:
    """A motion by its samples; the ground is at rest before the first one and after the last one.

    Args:
        step: From sample to sample, s.
        samples: (N,), m/s^2, the first one at time 0.
        in_g: Whether the file says that they are in g.
    """

    def __init__(self, step: float, samples: np.ndarray, in_g: bool = False) -> None:
        self.step, self.samples, self.in_g = step, samples, in_g
        padded = np.concatenate((np.zeros(ZEROS), samples, np.zeros(ZEROS)))
        # Not above: it takes a second to import, and every run reads this module.
        from scipy.interpolate import make_interp_spline
        from scipy.signal import resample

        dense = resample(padded, OVERSAMPLING * len(padded))
        time = (step / OVERSAMPLING) * np.arange(len(dense)) - step * ZEROS
        self._spline = make_interp_spline(time, dense, k=SPLINE_DEGREE)
        self._ends = time[0], time[-1]

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return self.step * (len(self.samples) - 1)

    def power_above(self, frequency: float) -> float:
        """Share of the power above a frequency (Hz), 0 to 1."""
        power = np.abs(np.fft.rfft(self.samples)) ** 2
        above = np.fft.rfftfreq(len(self.samples), self.step) > frequency
        return float(power[above].sum() / power.sum())

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """(M,), m/s^2, at times (M,), s."""
        low, high = self._ends
        return np.where((time >= low) & (time <= high), self._spline(np.clip(time, low, high)), 0.0)

    @classmethod
    def read(cls, path: Path, step: float | None) -> RecordedMotion:
        """From a text file: lines of time (s) and acceleration; or accelerations one after the other, with their step.

        The step is ``step``, or what a line of the header says, such as DT= .01 SEC. Lines before the first number are
        a header. Columns are separated by commas, semicolons, blanks or tabs.

        Raises:
            InputError: Naming ``excitation.path`` or ``excitation.step``; tells the line.
        """
        from pinn_cli.record.files.csv import rate_above  # not above: pandas takes a while

        header, rows = _rows(path)
        rate, values = rate_above(header, "."), np.concatenate(rows)
        pairs = np.array(rows) if {len(row) for row in rows} == {2} else None
        if pairs is not None and bool(np.all(np.diff(pairs[:, 0]) > 0)):
            if step is not None:
                raise InputError("excitation.step", step, "null", f"{path.name} has times of its own")
            values, step = pairs[:, 1], _uniform_step(path, pairs[:, 0], len(header) + 1)
        elif step is not None:
            step = positive_number("excitation.step", step)
        elif rate is not None:  # PEER's: NPTS= 4000, DT= .0100 SEC
            step = 1.0 / rate
        else:
            hint = f"{path.name} has no two columns, growing time and acceleration"
            raise InputError("excitation.step", None, "given, the time between two values in s", hint)
        if len(values) < MINIMUM_SAMPLES or not values.any() or np.abs(values).max() > LARGEST:
            content = f"{len(values)} values, the largest of them {np.abs(values).max():g}"
            raise InputError(
                MOTION_SETTING, path, f"{MINIMUM_SAMPLES} values or more, not all 0, to {LARGEST:g}", content
            )
        return cls(step, values, in_g=re.search(r"units? (?:of|in) g\b", " ".join(header), re.IGNORECASE) is not None)


def _rows(path: Path) -> tuple[list[str], list[list[float]]]:
    """The lines of the header, and the numbers of every line after it."""
    lines = read_text(path, MOTION_SETTING).splitlines()
    rows: dict[int, list[float]] = {}
    for number, line in enumerate(lines, start=1):
        try:
            row = [float(cell) for cell in _SEPARATOR.split(line.strip()) if cell]
        except ValueError:
            row = [np.nan]
        if np.isfinite(row).all():
            rows |= {number: row} if row else {}
        elif rows:
            hint = f"{path.name}, line {number} reads {line.strip()[:SHOWN]!r}"
            raise InputError(MOTION_SETTING, path, "a file of finite numbers", hint)
    if not rows:
        raise InputError(MOTION_SETTING, path, "a file of numbers", f"{path.name} has none")
    return lines[: min(rows) - 1], list(rows.values())


def _uniform_step(path: Path, time: np.ndarray, first: int) -> float:
    """The step of times (N,) that the file has from line ``first`` on."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    usual = float(np.median(np.diff(time)))
    off = np.abs(time - (time[0] + step * np.arange(len(time))))
    if off.max() > AXIS_TOLERANCE * usual:
        row = int(np.argmax(np.abs(np.diff(time) - usual))) + 1
        hint = f"{path.name}, line {first + row}: {time[row]:g} s after {time[row - 1]:g} s"
        raise InputError(MOTION_SETTING, path, f"a file with one step, {usual:g} s", hint)
    return step
