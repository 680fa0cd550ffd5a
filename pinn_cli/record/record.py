"""Time histories: what was measured, what is true, and the wall between the two.

Arrays are numpy float64 (time, dof), SI units. DOFs are counted from 1 wherever a person gives them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from pinn_cli.record.between_samples import INTERSAMPLE, Intersample
from pinn_cli.record.gauge import Gauge
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Repeats, Response
from pinn_cli.record.spectrum import BandPass, level_at_end
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import one_of
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT

Frame = Literal["absolute", "relative"]
FRAMES: tuple[str, ...] = get_args(Frame)

# Fewer samples than this are no time history: three points per knot of a spline leave nothing to estimate.
MINIMUM_SAMPLES = 16


@dataclass(frozen=True, eq=False)
class Record:
    """All that an estimator may see.

    Attributes:
        time: (N,), s, uniform; it need not begin at 0, and the structure need not begin at rest.
        displacement, velocity, acceleration: (N, n), measured; a column of NaN where there is no sensor.
        force: (N, n), measured; a column of NaN where the force is unknown; 0 where there is known to be none.
        unforced: (n,) bool, the DOFs that are known to carry no force.
        intersample: How the force behaves between the samples.
        assumed: Whether nobody said so.
        ground_acceleration: (N,), measured, m/s^2; None where the ground is at rest.
        frame: What accelerometers measure where the ground moves: ``absolute``, as sensors on the structure do, or
            ``relative`` to the ground. Displacements and velocities are relative to it always.
        repeats: Where the histories are means of repeated measurements, how far those scattered.
        simulated: Whether a simulation of the configured structure made it. What is prescribed for an unknown parameter
            is then the truth, and to be forgotten; of a measured record it is what the user knows.
        dofs: What the user calls the DOFs, n names; empty: they go by their numbers.
        gauges: Sensors that take more to describe than a column. One of a single DOF fills its column as well, as it is
            believed to be calibrated and by straight lines where samples are missing: for orders of magnitude, spectra
            and figures. What it says is in its own samples (:meth:`gauged`).
        missing: Quantity to (N, channels) bool, where a column shows something else for want of a sample, once that is
            known; none where every sample is one.
        responds: Whether a response was measured; otherwise it is what acts on a structure, and no more.
        supports: Name in :data:`pinn_cli.system.quantities.SUPPORT` to (N, S), what was measured of the motion of the
            structure's S supports; a column of NaN where it was not.
        support_names: What the user calls them.
        band: The filter that all channels went through; None: they are as measured.
        beside: Name of a gauge that fills no column to what it felt at the record's times (N,), and to where it has a
            sample there (N,) bool, once that is known.
        supports_begin: (2, S), displacement and velocity of the supports at the first sample, which no accelerometer
            tells; None: rest.

    Raises:
        InputError: No response sensor at all; a held force where the ground moves.
        ValueError: Shapes, time axis, half-filled columns or forces on unforced DOFs that contradict the above.
    """

    time: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray
    unforced: np.ndarray
    intersample: Intersample = "band_limited"
    assumed: bool = False
    repeats: Repeats | None = None
    simulated: bool = False
    ground_acceleration: np.ndarray | None = None
    frame: Frame = "absolute"
    dofs: tuple[str, ...] = ()
    gauges: tuple[Gauge, ...] = ()
    missing: Mapping[str, np.ndarray] = field(default_factory=dict)
    responds: bool = True
    supports: Mapping[str, np.ndarray] = field(default_factory=dict)
    support_names: tuple[str, ...] = ()
    supports_begin: np.ndarray | None = None
    band: BandPass | None = None
    beside: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("time", *QUANTITIES):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
        object.__setattr__(self, "unforced", np.asarray(self.unforced, dtype=bool))
        if self.intersample not in INTERSAMPLE:
            raise InputError("data.intersample", self.intersample, f"one of {', '.join(INTERSAMPLE)}")
        one_of("data.frame", self.frame, FRAMES)
        self._check_time()
        self._check_columns()
        self._check_ground()
        felt = self.observed.any() or any(gauge.quantity in RESPONSE_QUANTITIES for gauge in self.gauges)
        if self.responds and not felt:
            raise InputError("record", "no response sensor", "one with a displacement, velocity or acceleration sensor")

    def _check_time(self) -> None:
        if self.time.ndim != 1 or len(self.time) < MINIMUM_SAMPLES:
            raise ValueError(f"time has shape {self.time.shape}; it must be ({MINIMUM_SAMPLES} or more,)")
        if not np.all(np.isfinite(self.time)) or self.step <= 0:
            raise ValueError("time must be finite and grow")
        # Clock times since 1970 have few digits left for the step: allow them their rounding.
        rounding = 4.0 * float(np.spacing(np.max(np.abs(self.time))))
        if np.ptp(np.diff(self.time)) > 1e-6 * self.step + rounding:
            raise ValueError("time must grow by one constant step")

    def _check_columns(self) -> None:
        shape = (len(self.time), self.unforced.size)
        for quantity in QUANTITIES:
            values = getattr(self, quantity)
            if values.shape != shape:
                raise ValueError(f"{quantity} has shape {values.shape}; it must be (time, dof) = {shape}")
            if not np.all(np.isfinite(values).all(axis=0) | np.isnan(values).all(axis=0)):
                raise ValueError(
                    f"every column of {quantity} must be finite throughout (a sensor) or NaN throughout (none)"
                )
        if np.any(self.force[:, self.unforced] != 0.0):
            raise ValueError("the force on an unforced DOF must be 0")

    def _check_ground(self) -> None:
        if self.ground_acceleration is not None:
            values = np.asarray(self.ground_acceleration, dtype=np.float64)
            object.__setattr__(self, GROUND, values)
            if values.shape != self.time.shape or not np.isfinite(values).all():
                raise ValueError(f"{GROUND} must be {self.time.shape} finite numbers; its shape is {values.shape}")
        if self.intersample == "zero_order_hold" and (self.supports or self.ground_acceleration is not None):
            allowed = f"band_limited where {'a support' if self.supports else 'the ground'} moves"
            raise InputError("data.intersample", self.intersample, allowed, "nothing holds it between samples")

    @property
    def ndof(self) -> int:
        """Number of degrees of freedom."""
        return self.unforced.size

    def dof_name(self, dof: int) -> str:
        """What people call a DOF, counted from 0: its name, or its number from 1."""
        return self.dofs[dof] if self.dofs else str(dof + 1)

    def dof_names(self, dofs: Iterable[int]) -> str:
        """Of several, with what they are: ``DOF 2``, ``DOFs roof, mezzanine``."""
        names = [self.dof_name(int(dof)) for dof in dofs]
        return f"DOF{'s' if len(names) > 1 else ''} {', '.join(names)}"

    @property
    def step(self) -> float:
        """Time from sample to sample, s."""
        return self.duration / (len(self.time) - 1)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def sampling_rate(self) -> float:
        """Samples per second, Hz."""
        return 1.0 / self.step

    @property
    def response_quantities(self) -> tuple[str, ...]:
        """What response sensors measure: of every DOF, and of the ground and supports where they move."""
        ground = () if self.ground_acceleration is None else (GROUND,)
        return (*RESPONSE_QUANTITIES, *ground, *self.supports)

    def histories(self, quantity: str) -> np.ndarray:
        """(N, channels) of a quantity: n of the DOFs' ones, one of the ground's, S of the supports'."""
        if quantity in SUPPORT:
            return self.supports[quantity]
        values: np.ndarray = getattr(self, quantity)
        return values[:, None] if quantity == GROUND else values

    def sensors(self, quantity: str) -> np.ndarray:
        """(channels,) bool: the DOFs whose ``quantity`` is measured. A force that is known to be zero is no sensor."""
        measured: np.ndarray = np.isfinite(self.histories(quantity)[0])
        return np.logical_and(measured, ~self.unforced) if quantity == "force" else measured

    @cached_property
    def is_filtered(self) -> bool:
        """Whether every channel ends as one behind an anti-alias filter does; one that is white to the end has none."""
        columns = (self.histories(q)[:, self.sensors(q)].T for q in (*self.response_quantities, FORCE))
        return all(level_at_end(column, self.step) is not None for every in columns for column in every if column.any())

    def gauged(self, quantity: str) -> np.ndarray:
        """(channels,) bool: those whose column only shows what a gauge is believed to have measured."""
        gauged = np.zeros(self.histories(quantity).shape[1], dtype=bool)
        gauged[[g.dof for g in self.gauges if g.quantity == quantity and g.dof is not None]] = True
        return gauged

    def there(self, quantity: str, channel: int) -> np.ndarray | None:
        """(N,) bool, where a channel has a sample; None: everywhere, as far as is known."""
        missing = self.missing.get(quantity)
        return None if missing is None or not missing[:, channel].any() else ~missing[:, channel]

    def started_at(self, calibrations: Mapping[str, Mapping[str, float]]) -> Record:
        """The record whose gauges' unknown numbers start elsewhere; its columns show what they then say."""
        if not {gauge.name for gauge in self.gauges} & set(calibrations):
            return self
        gauges = tuple(gauge.started_at(calibrations.get(gauge.name, {})) for gauge in self.gauges)
        columns: dict[str, Any] = {
            name: np.array(getattr(self, name)) for name in {g.quantity for g in gauges if g.dof is not None}
        }
        for gauge in gauges:
            if gauge.dof is not None:
                shown = gauge.history(self.time)
                if gauge.quantity == GROUND:
                    columns[GROUND] = shown
                else:
                    columns[gauge.quantity][:, gauge.dof] = shown
        return replace(self, gauges=gauges, **columns)

    @property
    def observed(self) -> np.ndarray:
        """(n,) bool: the DOFs with a displacement, velocity or acceleration sensor."""
        return np.any([self.sensors(quantity) for quantity in RESPONSE_QUANTITIES], axis=0)

    def keep(self, dofs_by_quantity: Mapping[str, Iterable[int]]) -> Record:
        """The record with only the named response sensors; the others, and quantities that are not named, are blanked.

        Args:
            dofs_by_quantity: "displacement", "velocity", "acceleration" to DOFs, counted from 1. A DOF without a sensor
                stays without.

        Raises:
            InputError: No response sensor is left.
            ValueError: A quantity or a DOF that does not exist.
        """
        if not set(dofs_by_quantity) <= set(RESPONSE_QUANTITIES):
            raise ValueError(f"{tuple(dofs_by_quantity)} are not all of {', '.join(RESPONSE_QUANTITIES)}")

        def blanked(quantity: str) -> np.ndarray:
            kept = dof_mask(dofs_by_quantity.get(quantity, ()), self.ndof)
            return np.where(kept, getattr(self, quantity), np.nan)

        def stays(gauge: Gauge) -> bool:
            return gauge.quantity not in RESPONSE_QUANTITIES or all(
                dof + 1 in dofs_by_quantity.get(gauge.quantity, ()) for dof in gauge.weights
            )

        return replace(
            self,
            gauges=tuple(gauge for gauge in self.gauges if stays(gauge)),
            displacement=blanked("displacement"),
            velocity=blanked("velocity"),
            acceleration=blanked("acceleration"),
        )

    def without_load_cells(self) -> Record:
        """The record in which the force on every forced DOF is unknown."""
        gauges = tuple(gauge for gauge in self.gauges if gauge.quantity != "force")
        return replace(self, force=np.where(self.unforced, self.force, np.nan), gauges=gauges)

    def carried_by(self, motion: np.ndarray, first: int = 0) -> Record:
        """The record under another motion (N, 3, S) of the supports, for what begins at a sample."""
        supports = {quantity: motion[:, order] for order, quantity in enumerate(SUPPORT)}
        return replace(self, supports=supports, supports_begin=motion[first, :2])

    def until(self, samples: int) -> Record:
        """The record's first samples; see :meth:`part`."""
        return self.part(0, samples)

    def part(self, first: int, stop: int) -> Record:
        """Samples first to stop (excluded); the scatter of repeats is known of the whole, and is shared out evenly."""
        histories = {name: getattr(self, name)[first:stop] for name in ("time", *QUANTITIES)}
        if self.ground_acceleration is not None:
            histories[GROUND] = self.ground_acceleration[first:stop]
        supports = {quantity: values[first:stop] for quantity, values in self.supports.items()}
        repeats, samples = self.repeats, len(histories["time"])
        if repeats is not None:
            left = samples / repeats.samples
            repeats = replace(repeats, samples=samples, square={q: left * s for q, s in repeats.square.items()})
        ends = float(histories["time"][0]) if first else -np.inf, float(histories["time"][-1])
        gauges = tuple(gauge.between(*ends) for gauge in self.gauges)
        gauges = tuple(gauge for gauge in gauges if len(gauge.time))
        return replace(self, **histories, repeats=repeats, gauges=gauges, supports=supports)


@dataclass(frozen=True, eq=False)
class Truth:
    """For scoring only; no estimator is ever handed this.

    Attributes:
        response: NaN where the truth is unknown.
        parameters: Name to (n,), of the true chain; None where unknown.
    """

    response: Response
    parameters: dict[str, np.ndarray] | None = None


@dataclass(frozen=True, eq=False)
class Measurements:
    """A record with every sensor that exists, and the truth beside it."""

    record: Record
    truth: Truth


def check_frame(frame: str, moves: bool, why: str) -> None:
    """Refuse a frame that does not exist, or one relative to a ground at rest.

    Args:
        frame: ``data.frame``.
        moves: Whether the record has a ground acceleration.
        why: It has none, for the message.

    Raises:
        InputError: Naming ``data.frame``.
    """
    one_of("data.frame", frame, FRAMES)
    if frame == "relative" and not moves:
        raise InputError("data.frame", frame, "absolute where the ground is at rest", why)


def dof_mask(dofs: Iterable[int], ndof: int) -> np.ndarray:
    """(ndof,) bool from DOFs counted from 1.

    Raises:
        ValueError: A DOF outside 1..ndof.
    """
    mask = np.zeros(ndof, dtype=bool)
    for dof in dofs:
        if not 1 <= dof <= ndof:
            raise ValueError(f"DOF {dof} is outside 1..{ndof}")
        mask[dof - 1] = True
    return mask
