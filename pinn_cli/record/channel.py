"""A channel: one sensor, what it feels, its samples and its calibration.

It feels one DOF, a sum of DOFs, the ground, a support or the force of a connection, has a gain, an offset, a drift or a
delay that may be in doubt, and samples of its own: some may be missing, and its rate may differ from the record's.

    y(t) = gain x(t - delay) + offset + drift (t - start) + noise

with x what it feels. Of an accelerometer that tilts, x holds the displacement of its place as well, by g over the
length that it turns about; one that passes no slow motion shows x behind a high-pass filter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pinn_cli.record.between_samples import SPLINE_DEGREE, BandLimited
from pinn_cli.record.response import Response
from pinn_cli.system.quantities import (
    CALIBRATION_UNITS,
    CONNECTION_FORCE,
    GROUND,
    HIGH_PASS,
    INPUTS,
    MOTION,
    SUPPORT,
    TILT,
)

# Part of a step by which even samples may come early or late.
EVEN = 0.02
# Points in a step at which a sensor's filter is applied to a history.
FILTER_POINTS = 8
# Of the residuals and noise levels of channels with samples or a calibration of their own, as files call them.
CALIBRATED = "gauge"
# The DOF of the ground's channel, counted from 0; a reader, who counts from 1, sees it as 0.
GROUND_DOF = -1
# Prior standard deviation of what is unknown: of a gain, which is about one; of an offset or of a drift over the whole
# record, in rms of the channel; of a delay, in samples of the channel.
WIDEST_GAIN, WIDEST_OFFSET, WIDEST_DELAY = 10.0, 10.0, 5.0
# Prior standard deviation of a tilt, 1/s^2: g over a quarter of a metre, about which no floor turns. An unknown corner
# of a filter starts below those of most sensors, Hz.
WIDEST_TILT = 40.0
FIRST_CORNER, WIDEST_CORNER = 0.1, 10.0
# Standard deviations of its delay by which a channel may ask for motion before or after the record.
DELAYS_ALLOWED = 3.0
# Samples in a row that show a channel's noise; of fewer the emptiest part of a spectrum is often empty by chance.
FEWEST_IN_RUN = 256


@dataclass(frozen=True)
class Calibration:
    """One number of a sensor.

    Attributes:
        value: That is known or believed, or where an unknown one starts.
        std: Prior standard deviation; 0: it is known.
        unknown: Whether it is to be found from the record.
    """

    value: float
    std: float = 0.0
    unknown: bool = False

    @property
    def is_known(self) -> bool:
        """Whether nothing about it is in doubt."""
        return not self.unknown and self.std == 0.0

    def times(self, factor: float) -> Calibration:
        """The same in another unit."""
        return Calibration(factor * self.value, factor * self.std)


@dataclass(frozen=True, eq=False)
class Channel:
    """One sensor and what it measured.

    Attributes:
        key: Its name in ``data.channels``; "": it has none.
        quantity: One of :data:`pinn_cli.record.response.MEASURED_QUANTITIES`, or ``connection_force``.
        weights: DOF or support, counted from 0, to its weight in what is felt; none of the ground or of a connection.
        time: (J,), s, of its samples, ascending.
        measured: (J,), SI units.
        calibration: ``gain``, ``offset``, ``drift`` (per second), ``delay`` (s), ``tilt`` (1/s^2) and ``high_pass``
            (Hz), by name.
        connection: Whose force it feels, counted from 0; -1: of none.
        fills: Whether a column of a record may show it: its DOF has no other sensor of the quantity.
        filter_order: Of the high-pass filter that it is behind, whose corner is in the calibration; 0: there is none.
        label: What the user calls the DOF or support; "": its number.
        gaps: (J,) bool, where there is no sample, and the history goes on without one; None: nowhere.
        index: Among the channels of its record that have samples or a calibration of their own, counted from 0.
    """

    key: str
    quantity: str
    weights: Mapping[int, float]
    time: np.ndarray
    measured: np.ndarray
    calibration: Mapping[str, Calibration] = field(default_factory=dict)
    connection: int = -1
    fills: bool = True
    filter_order: int = 0
    label: str = ""
    gaps: np.ndarray | None = None
    index: int = 0

    @property
    def dof(self) -> int:
        """The first DOF or support that it feels, counted from 0; `GROUND_DOF` where there is none."""
        return next(iter(self.weights), GROUND_DOF)

    @property
    def is_column(self) -> bool:
        """Whether a column of the record shows it: it feels one DOF, which has no other sensor of the quantity."""
        alone = self.quantity == GROUND or list(self.weights.values()) == [1.0]
        return self.fills and alone and self.quantity != CONNECTION_FORCE

    @property
    def place(self) -> tuple[str, int]:
        """Quantity and column among those of the quantity; of what is no column the place of its noise level."""
        return (self.quantity, max(self.dof, 0)) if self.is_column else (CALIBRATED, self.index)

    @property
    def where(self) -> str:
        """Name of the DOF or of the sensor, or the DOF's number, counted from 1."""
        return (self.label or str(self.dof + 1)) if self.is_column else self.key

    @property
    def name(self) -> str:
        """See :func:`named`; of what is no column ``displacement of sensor eps``."""
        return named(self.quantity, self.where) if self.is_column else f"{self.quantity} of sensor {self.key}"

    @property
    def setting(self) -> str:
        """Where a user gave it: ``data.acceleration, DOF 3``."""
        if not self.is_column:
            return f"data.channels.{self.key}"
        if self.quantity in SUPPORT:
            return f"data.channels, {self.name}"
        return f"data.{GROUND}" if self.quantity == GROUND else f"data.{self.quantity}, DOF {self.where}"

    @property
    def is_input(self) -> bool:
        """Whether it feels what acts on a structure."""
        return self.quantity in INPUTS

    @property
    def order(self) -> int:
        """How often the displacement is differentiated."""
        quantity = SUPPORT.get(self.quantity, self.quantity)
        return MOTION.index("acceleration" if quantity == GROUND else quantity)

    @property
    def there(self) -> np.ndarray:
        """(J,) bool, where a sample was measured."""
        return np.ones(len(self.time), dtype=bool) if self.gaps is None else ~self.gaps

    def number(self, kind: str) -> Calibration:
        """One number of its calibration, by default that of a perfect sensor."""
        return self.calibration.get(kind, Calibration(float(kind == "gain")))

    def _value(self, kind: str, estimates: Mapping[str, float] | None) -> float:
        return {kind: self.number(kind).value, **(estimates or {})}[kind]

    def of(self, response: Response) -> np.ndarray:
        """(N,), what a perfect sensor in its place feels of a response; NaN of what nobody worked out there."""
        values: np.ndarray | None
        if self.quantity in (*SUPPORT, GROUND, CONNECTION_FORCE):
            values = response.supports if self.quantity in SUPPORT else getattr(response, self.quantity)
            if values is None:
                return np.full(len(response.time), np.nan)
            if self.quantity in SUPPORT:
                return values[:, self.order, self.dof]
            return values if self.quantity == GROUND else values[:, self.connection]
        return np.asarray(getattr(response, self.quantity)[:, list(self.weights)] @ list(self.weights.values()))

    def shown_of(self, response: Response, estimates: Mapping[str, float] | None = None) -> np.ndarray:
        """The same with its tilt and behind its filter, as if that had begun at rest."""
        motion, tilt = self.of(response), self._value(TILT, estimates)
        if tilt:
            motion = motion + tilt * replace(self, quantity=MOTION[0]).of(response)
        return self.passed(response.time, motion, estimates)

    @property
    def feels_one(self) -> bool:
        """Whether it feels one function of time alone, or those of one equation."""
        return self.quantity == GROUND or (self.quantity != CONNECTION_FORCE and len(self.weights) == 1)

    @property
    def even_step(self) -> float | None:
        """From sample to sample, s; None where they are uneven."""
        steps = np.diff(self.time)
        step = float(np.median(steps))
        return step if np.ptp(steps) < EVEN * step else None

    @property
    def even_run(self) -> tuple[np.ndarray, float] | None:
        """Its longest run of even samples (R,), and the step, s; None where none is long enough to show its noise."""
        steps = np.diff(self.time)
        step = float(np.median(steps))
        uneven = np.flatnonzero(np.abs(steps - step) > EVEN * step + clock_rounding(self.time))
        breaks = np.concatenate(([-1], uneven, [len(steps)]))
        longest = int(np.argmax(np.diff(breaks)))
        first, last = breaks[longest] + 1, breaks[longest + 1]
        if last - first + 1 < min(FEWEST_IN_RUN, len(self.time)):
            return None
        return self.measured[first : last + 1], float(self.time[last] - self.time[first]) / int(last - first)

    @property
    def start(self) -> float:
        """The time from which its drift counts, s."""
        return float(self.time[0])

    def corrected_samples(self, estimates: Mapping[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Times (J,) at which it felt, s, and what it felt there (J,), noise included, by numbers that were found."""
        value = {kind: self._value(kind, estimates) for kind in CALIBRATION_UNITS}
        corrected = self.measured - value["offset"] - value["drift"] * (self.time - self.start)
        return self.time - value["delay"], corrected / (value["gain"] or 1.0)

    def places(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(J,), which of even times (N,) is next to that when it felt each sample, and how many steps that is off."""
        position = (self.corrected_samples()[0] - time[0]) / ((time[-1] - time[0]) / (len(time) - 1))
        place = np.rint(position).astype(np.int64)
        return place, position - place

    def history(self, time: np.ndarray, estimates: Mapping[str, float] | None = None) -> np.ndarray:
        """(N,), what it felt at other times; see :meth:`corrected_samples`.

        Through even samples as a band-limited history; by straight lines where they are uneven or missing. Beyond its
        samples it stays what it was at the last one.
        """
        at, values = self.corrected_samples(estimates)
        if np.array_equal(at, time):
            return values
        if len(values) <= SPLINE_DEGREE or self.even_step is None:
            return np.interp(time, at, values)
        return BandLimited(at, values)(np.clip(time, at[0], at[-1]))

    def passed(self, time: np.ndarray, x: np.ndarray, estimates: Mapping[str, float] | None = None) -> np.ndarray:
        """What its filter passes of a history (N,) at even times, as if it had begun at rest; all where there is none.

        The filter's rule of trapezia follows slow motion; the history is made denser for the rest of it.
        """
        if not self.filter_order:
            return x
        from scipy.signal import bilinear, lfilter

        dense = np.linspace(time[0], time[-1], FILTER_POINTS * (len(time) - 1) + 1)
        denominator = self._polynomial(estimates)[::-1]
        rule = bilinear([1.0, *[0.0] * self.filter_order], denominator, 1.0 / (dense[1] - dense[0]))
        return np.asarray(lfilter(*rule, BandLimited(time, x)(dense))[::FILTER_POINTS])

    def decays(self, time: np.ndarray, estimates: Mapping[str, float] | None = None) -> np.ndarray:
        """(N, order), what its filter shows of how it began."""
        since = (time - time[0])[:, None]
        root = np.roots(self._polynomial(estimates)[::-1])[:1] if self.filter_order else np.zeros(0)
        decay = np.exp(since * root)
        return np.hstack((decay.real, decay.imag))[:, : self.filter_order]

    def _polynomial(self, estimates: Mapping[str, float] | None) -> tuple[float, ...]:
        return filter_polynomial(2.0 * np.pi * self._value(HIGH_PASS, estimates), self.filter_order)

    def at(self, time: np.ndarray, values: np.ndarray, gaps: np.ndarray | None = None) -> Channel:
        """The same sensor as if it had been perfect and sampled at these times (N,), s, where it felt this (N,)."""
        return replace(self, time=time, measured=values, calibration={}, filter_order=0, gaps=gaps)

    def started_at(self, values: Mapping[str, float]) -> Channel:
        """The same where the search for its unknown numbers starts elsewhere; what is believed stays."""
        unknown = {kind: replace(self.number(kind), value=v) for kind, v in values.items() if self.number(kind).unknown}
        return replace(self, calibration={**self.calibration, **unknown}) if unknown else self

    def between(self, first: float, last: float) -> Channel:
        """The same with the samples between two times, s, alone."""
        kept = (self.time >= first) & (self.time <= last)
        return replace(self, time=self.time[kept], measured=self.measured[kept])


def unknown_calibration(kind: str, time: np.ndarray, values: np.ndarray, both: bool = False) -> Calibration:
    """Where an unknown number of a channel, one of `CALIBRATION_UNITS`, starts, and how wide its prior is.

    Its samples (J,) are at times (J,), s. Where offset and drift are both unknown a straight line goes through them.
    """
    rms = float(np.std(values)) or float(np.abs(values).max()) or 1.0
    duration = float(time[-1] - time[0])
    slope, level = np.polyfit(time - time[0], values, 1) if both else (0.0, float(np.mean(values)))
    start, width = {
        "gain": (1.0, WIDEST_GAIN),
        "offset": (float(level), WIDEST_OFFSET * rms),
        "drift": (float(slope), WIDEST_OFFSET * rms / duration),
        "delay": (0.0, WIDEST_DELAY * float(np.median(np.diff(time)))),
        TILT: (0.0, WIDEST_TILT),
        HIGH_PASS: (FIRST_CORNER, WIDEST_CORNER),
    }[kind]
    return Calibration(start, width, unknown=True)


def clock_rounding(time: np.ndarray) -> float:
    """By how much rounding alone makes steps differ, s: clock times since 1970 have few digits left for them."""
    return 4.0 * float(np.spacing(np.max(np.abs(time))))


def filter_polynomial(corner: float, order: int) -> tuple[float, ...]:
    """Coefficients a_0 to a_order of p^(order) + ... + a_0 p = x, of which a high-pass filter shows p^(order).

    Half of the power passes its corner, rad/s; of order 2 it is the flattest one (Butterworth).
    """
    return (corner, 1.0) if order == 1 else (corner**2, 2.0**0.5 * corner, 1.0)


def named(quantity: str, where: str) -> str:
    """A channel as sentences have it: ``acceleration of DOF 3``, ``ground acceleration``."""
    if quantity in SUPPORT:
        return f"{SUPPORT[quantity]} of support {where}"
    return "ground acceleration" if quantity == GROUND else f"{quantity} of DOF {where}"
