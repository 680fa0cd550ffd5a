"""Columns of a record as they are inspected, their samples on a regular clock, and the peaks that they show.

Natural frequencies and damping ratios come from a rational fit around each peak. With a measured input that is the
local rational method (McKelvey and Guerin, IFAC Proceedings Volumes 45(16), 2012): around a peak the spectra of the
whole record obey Y = (B U + T) / A with a second-order A, the same for all sensors, and polynomials B and T, which hold
the other modes and the motion before and after the record. No window is used, so damping does not come out too large.
Without an input the sensors' periodogram is fitted by |A|^-2, a constant and a slope, by Whittle's likelihood (Arkiv
foer Matematik 2(23), 1953), as if a force of even power acted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.channels import named
from pinn_cli.record.cross_spectra import CrossSpectra, independent_part, taper
from pinn_cli.record.response import GROUND, UNITS
from pinn_cli.record.spectrum import decimate, periodogram, signal_band
from pinn_cli.record.units import si_factor
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import MOTION, SUPPORT

# Times off the regular axis by more than this part of a step are put onto it.
EVEN = 0.05
# What acts on a structure.
INPUTS = ("force", GROUND, *SUPPORT)
# A record keeps this many times the highest frequency of its content, and so many samples.
OVERSAMPLED, FEWEST_SAMPLES = 4.0, 256
# A peak stands out by so many dB; as many are looked for at most.
PROMINENCE_DB, MOST = 3.0, 16
# Lines of a spectrum around a peak: at least, and in half-power widths; and degrees of the polynomials.
LINES, WIDTHS, DEGREE = 24, 2.0, 3
# Peaks that are fitted as damped as this, or whose frequency is this uncertain, are none.
MOST_DAMPED, MOST_UNCERTAIN, MOST_UNCERTAIN_DAMPING = 0.3, 0.02, 0.6
# A peak's coherence exceeds what chance reaches so often; in the end it is no less than this.
CHANCE, LEAST_COHERENCE = 0.02, 0.2


@dataclass(frozen=True, eq=False)
class Signal:
    """One column.

    Attributes:
        column: Its name in the file.
        values: (N,), in ``unit``; NaN where a cell is empty.
        quantity: displacement, velocity, acceleration, force or ground_acceleration; "": nobody has said.
        place: Number or name of the DOF or support; "" of the ground, and where nobody has said.
        unit: "": nobody has said; where it is known what is measured, SI.
    """

    column: str
    values: np.ndarray
    quantity: str = ""
    place: str = ""
    unit: str = ""

    @property
    def name(self) -> str:
        """As sentences have it: ``acceleration of DOF 3``; else the column in quotes."""
        return named(self.quantity, self.place) if self.quantity else repr(self.column)

    @property
    def is_input(self) -> bool:
        """Whether it is what acts."""
        return self.quantity in INPUTS

    @property
    def order(self) -> int:
        """How often the displacement is differentiated; a sensor of which nobody has said anything counts as others."""
        return MOTION.index(self.quantity) if self.quantity in MOTION else 2

    @property
    def shown_unit(self) -> str:
        """Its own, else that of the quantity, which is taken for granted."""
        return self.unit or UNITS.get(self.quantity, "")

    def in_si(self) -> tuple[Signal, str]:
        """The same in SI units, and a sentence where its unit is none of its quantity's."""
        if not self.unit or self.quantity not in UNITS:
            return self, ""
        plain = UNITS[self.quantity]
        try:
            factor = si_factor(f"unit of {self.column}", self.unit, self.quantity)
        except InputError:
            says = f"the file says that {self.name} is in {self.unit}, which is no unit of it"
            how = f"unit: 1 in the command below takes one {self.unit} for one {plain}"
            return replace(self, unit=plain), f"{says}: {how}; or say how many (data.channels.{self.column}.unit)"
        return replace(self, values=factor * self.values if factor != 1.0 else self.values, unit=plain), ""


@dataclass(frozen=True, eq=False)
class Sampling:
    """When the samples of a record were taken.

    Attributes:
        time: (N,), s, increasing.
    """

    time: np.ndarray

    @property
    def step(self) -> float:
        """The usual step, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def rate(self) -> float:
        """Hz, from all steps but the holes: their mean has more digits than one of them is printed with."""
        steps = np.diff(self.time)
        return 1.0 / float(np.mean(steps[steps <= 1.5 * self.step]))

    @property
    def duration(self) -> float:
        """S."""
        return float(self.time[-1] - self.time[0])

    @property
    def holes(self) -> list[tuple[float, float]]:
        """Times before and after every step that is longer than one and a half usual ones, s."""
        after = np.flatnonzero(np.diff(self.time) > 1.5 * self.step)
        return [(float(self.time[i]), float(self.time[i + 1])) for i in after]

    @property
    def jitter_percent(self) -> float:
        """Root mean square deviation of the steps from the usual one, holes left out, % of it."""
        steps = np.diff(self.time)
        steps = steps[steps <= 1.5 * self.step]
        return float(100.0 * np.sqrt(np.mean((steps / self.step - 1.0) ** 2)))

    @property
    def regular(self) -> np.ndarray:
        """(M,), s: from the first sample to the last at the usual rate; the times themselves, where they are even."""
        count = round(self.duration * self.rate) + 1
        axis = self.time[0] + np.arange(count) / self.rate
        even = count == len(self.time) and np.max(np.abs(axis - self.time)) <= EVEN * self.step
        return self.time if even else axis

    def on_regular(self, values: np.ndarray) -> np.ndarray:
        """Samples (N,) at `regular`, (M,); straight lines over what is missing.

        Raises:
            ValueError: There are none.
        """
        there = np.isfinite(values)
        if not there.any():
            raise ValueError("a column without a number")
        axis = self.regular
        if axis is self.time and there.all():
            return values
        return np.interp(axis, self.time[there], values[there])


def spectra_of(signals: Sequence[Signal], sampling: Sampling, highest: float | None = None) -> CrossSpectra[Signal]:
    """Of a record's columns after decimation to its band; those of which nobody has said anything count as sensors.

    Args:
        signals: With numbers that vary.
        sampling: Of their values.
        highest: Frequency of any channel's content, Hz; None: it is looked for.
    """
    sensors = [signal for signal in signals if not signal.is_input]
    acting = [signal for signal in signals if signal.is_input]
    values = np.stack([sampling.on_regular(signal.values) for signal in (*sensors, *acting)], axis=1)
    values, step = values - values.mean(axis=0), 1.0 / sampling.rate
    if highest is None:
        highest = max(signal_band(column, step) for column in values.T)
    factor = max(1, int(1.0 / (step * OVERSAMPLED * highest))) if highest > 0.0 else 1
    factor = min(factor, max(1, len(values) // FEWEST_SAMPLES))
    return CrossSpectra.of_pieces(sensors, acting, decimate(values, factor), step * factor)


@dataclass(frozen=True)
class Peak:
    """A natural frequency that a record shows.

    Attributes:
        frequency: Undamped, Hz.
        frequency_std: Hz.
        damping: Ratio, 0 to 1.
        damping_std: The same.
        coherence: Of the sensors there, the median; NaN without an input.
        prominence_db: By how much the mean spectrum of all sensors stands above the lower of the valleys beside it.
    """

    frequency: float
    frequency_std: float
    damping: float
    damping_std: float
    coherence: float
    prominence_db: float = np.nan


def find_peaks(spectra: CrossSpectra[Signal]) -> list[Peak]:
    """In order of their frequency; those that a fit does not bear out are left out."""
    if not spectra.sensors:
        return []
    candidates, prominences = _candidates(spectra)
    fit = _fit_response if spectra.acting else _fit_power
    found: list[Peak] = []
    for i, (place, prominence) in enumerate(zip(candidates, prominences, strict=True)):
        low = 0.5 * (place + candidates[i - 1]) if i else 0.3 * place
        high = 0.5 * (place + candidates[i + 1]) if i + 1 < len(candidates) else 1.7 * place
        peak = fit(spectra, float(place), float(low), float(high))
        alone = not found or (peak is not None and peak.frequency - found[-1].frequency > 2.0 * found[-1].frequency_std)
        if peak is not None and alone:
            found.append(replace(peak, prominence_db=float(prominence)))
    return found


def _candidates(spectra: CrossSpectra[Signal]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of the strongest peaks of all sensors together, Hz, ascending, and their prominences, dB.

    Sensors of all kinds count as accelerometers, each against its own median.
    """
    from scipy import signal

    f = spectra.frequency
    level = np.sum(np.abs(spectra.response) ** 2, axis=2) if spectra.acting else spectra.power
    level = level * f[:, None] ** (4 - 2 * spectra.orders)
    highest = max(signal_band(column, spectra.step) for column in spectra.shown.T)
    usable = (f > 2.0 * f[1]) & (f <= min(highest, 0.9 * f[-1]))
    if spectra.acting:  # what the input does not explain is noise
        level = level * np.clip(spectra.coherence, 1e-3, 1.0)
        usable &= spectra.coherence.max(axis=1) > spectra.chance_coherence(CHANCE)
    if not usable.any():
        return np.zeros(0), np.zeros(0)
    with np.errstate(divide="ignore"):
        together = 10.0 * np.log10(np.mean(level / np.maximum(np.median(level[usable], axis=0), 1e-300), axis=1))
    together = np.where(np.isfinite(together), together, -300.0)
    places, found = signal.find_peaks(together, prominence=PROMINENCE_DB)
    kept = [(p, i) for i, p in zip(places, found["prominences"], strict=True) if usable[i]]
    strongest = sorted((i, p) for p, i in sorted(kept, reverse=True)[:MOST])
    return f[[i for i, _ in strongest]], np.array([p for _, p in strongest])


def _fit_response(spectra: CrossSpectra[Signal], place: float, low: float, high: float) -> Peak | None:
    """The local rational method around one peak, by least squares of the output's error."""
    from scipy.fft import rfft, rfftfreq
    from scipy.optimize import least_squares

    f = rfftfreq(len(spectra.values), spectra.step)
    width = max(WIDTHS * 0.05 * place, LINES * f[1])
    lines = np.flatnonzero((f >= max(low, place - width)) & (f <= min(high, place + width)))
    if len(lines) < LINES:
        lines = np.flatnonzero((f >= place - 0.5 * LINES * f[1]) & (f <= place + 0.5 * LINES * f[1]) & (f > 0))
    y, u = np.split(rfft(spectra.values, axis=0)[lines], [len(spectra.sensors)], axis=1)
    s, local = 1j * f[lines] / place, (f[lines] - place) / max(np.ptp(f[lines]), 1e-300)
    powers = local[:, None] ** np.arange(DEGREE + 1)
    basis = np.concatenate([powers * u[:, j : j + 1] for j in range(u.shape[1])] + [powers], axis=1)
    basis = basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    weights = np.ones(y.shape[1])

    def left(parameters: np.ndarray) -> np.ndarray:
        """What polynomials over A leave of every sensor, (lines, outputs)."""
        damping, square = parameters
        explained, _ = np.linalg.qr(basis / (s**2 + damping * s + square)[:, None])
        return y - explained @ (np.conj(explained.T) @ y)

    def residual(parameters: np.ndarray) -> np.ndarray:
        error = (left(parameters) * weights).ravel()
        return np.concatenate([error.real, error.imag])

    starts = [(2.0 * zeta, 1.0) for zeta in (0.003, 0.01, 0.03)]
    best = np.array(min(starts, key=lambda start: float(np.sum(np.abs(left(np.array(start))) ** 2))))
    freedom = 2.0 * (len(lines) - basis.shape[1])
    if freedom < 4.0:
        return None
    for _ in range(2):  # sensors count by what is left of them
        size = np.sqrt(2.0 * np.sum(np.abs(left(best)) ** 2, axis=0) / freedom)
        weights = 1.0 / np.maximum(size, 1e-12 * np.linalg.norm(y, axis=0) + 1e-300)
        solved = least_squares(residual, best, x_scale=(0.01, 0.01), max_nfev=60)
        best = solved.x
    shape = (2, *y.shape)
    covariance = _covariance(solved.jac.reshape(*shape, 2), solved.fun.reshape(shape), freedom / (2.0 * len(lines)))
    return _peak(spectra, place, covariance, best, (f[lines[0]], f[lines[-1]]))


def _fit_power(spectra: CrossSpectra[Signal], place: float, low: float, high: float) -> Peak | None:
    """The sensors' periodogram around one peak, by Fisher scoring of Whittle's likelihood."""
    spectrum = [periodogram(column, spectra.step) for column in spectra.shown.T]
    f = spectrum[0][0]
    width = max(WIDTHS * 0.05 * place, LINES * f[1])
    lines = np.flatnonzero((f >= max(low, place - width)) & (f <= min(high, place + width)) & (f > 0))
    if len(lines) < LINES:
        return None
    power = np.mean([p[lines] / max(float(p[lines].mean()), 1e-300) for _, p in spectrum], axis=0)
    s, local = 1j * f[lines] / place, (f[lines] - place) / place
    constant, slope = np.ones(len(lines)), local / np.max(np.abs(local))
    floor = float(np.quantile(power, 0.1)) + 1e-12
    found = np.array([0.04, 1.0, 0.04**2 * float(power.max()) / 4.0, floor, 0.0])
    jacobian = np.zeros((len(lines), 5))
    for _ in range(60):
        a = s**2 + found[0] * s + found[1]
        shape = np.abs(a) ** -2
        level = np.maximum(found[2] * shape + found[3] * constant + found[4] * slope, 1e-3 * floor)
        turned = -2.0 * found[2] * shape**2
        jacobian = np.stack([turned * (np.conj(a) * s).real, turned * a.real, shape, constant, slope], axis=1)
        jacobian /= level[:, None]
        step, *_ = np.linalg.lstsq(jacobian, (power - level) / level, rcond=None)
        size = np.max(np.abs(step[:2]) / np.array([0.5 * abs(found[0]) + 1e-4, 0.01]))
        found = found + step / max(1.0, float(size))
        found[0], found[2] = max(found[0], 1e-5), max(found[2], 0.0)
        if size < 1e-6:
            break
    left = ((power - level) / level)[:, None]
    covariance = _covariance(jacobian[:, None], left, 1.0 - 5.0 / len(lines)) / independent_part(
        taper(len(spectra.values))
    )
    return _peak(spectra, place, covariance, found, (f[lines[0]], f[lines[-1]]))


def _covariance(jacobian: np.ndarray, residual: np.ndarray, free: float) -> np.ndarray:
    """Of a fit by least squares whose errors go together at a line, as those that a noisy input makes in all sensors.

    Liang and Zeger, Biometrika 73 (1986) 13: a line is a group, and no error is taken to be as large as another.

    Args:
        jacobian: (..., lines, outputs, parameters), of all residuals.
        residual: (..., lines, outputs).
        free: Part of the lines that is not used up.
    """
    p = jacobian.shape[-1]
    inverse = np.linalg.pinv(jacobian.reshape(-1, p).T @ jacobian.reshape(-1, p))
    scores = np.sum(jacobian * residual[..., None], axis=-2).reshape(-1, residual.shape[-2], p).sum(axis=0)
    return np.asarray(inverse @ (scores.T @ scores) @ inverse / free)


def _peak(
    spectra: CrossSpectra[Signal], place: float, covariance: np.ndarray, found: np.ndarray, within: Sequence[float]
) -> Peak | None:
    """From A's coefficients, if they are those of a lightly damped mode within the lines of the fit."""
    damping, square = map(float, found[:2])
    if square <= 0.0 or not np.isfinite(covariance).all():
        return None
    frequency, zeta = place * square**0.5, 0.5 * damping / square**0.5
    frequency_std = 0.5 * frequency * covariance[1, 1] ** 0.5 / square
    damping_std = 0.5 * covariance[0, 0] ** 0.5 / square**0.5
    inside = within[0] < frequency < within[1] and 0.0 < zeta < MOST_DAMPED
    # Narrower than a line of the spectrum, a peak is a line: a sine, or chance.
    inside = inside and 2.0 * zeta * frequency * len(spectra.values) * spectra.step > 0.5
    inside = inside and frequency_std > 0.0 and damping_std > 0.0
    if not inside or frequency_std > MOST_UNCERTAIN * frequency or damping_std > MOST_UNCERTAIN_DAMPING * zeta:
        return None
    coherence = np.nan
    if spectra.acting:
        nearest = int(np.argmin(np.abs(spectra.frequency - frequency)))
        coherence = float(np.median(spectra.coherence[max(nearest - 1, 0) : nearest + 2]))
        if coherence < LEAST_COHERENCE:
            return None
    return Peak(float(frequency), float(frequency_std), zeta, float(damping_std), coherence)
