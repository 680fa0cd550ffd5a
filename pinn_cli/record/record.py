"""Time histories: what was measured, what is true, and the wall between the two.

Arrays are numpy float64 (time, dof), SI units. DOFs are counted from 1 wherever a person gives them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from pinn_cli.record.between_samples import INTERSAMPLE, Intersample
from pinn_cli.record.channel import Channel, clock_rounding
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
        ground_acceleration: (N,), measured, m/s^2; NaN where nobody measured how it moves, None where it is at rest.
        frame: What accelerometers measure where the ground moves: ``absolute``, as sensors on the structure do, or
            ``relative`` to the ground. Displacements and velocities are relative to it always.
        repeats: Where the histories are means of repeated measurements, how far those scattered.
        simulated: Whether a simulation of the configured structure made it. What is prescribed for an unknown parameter
            is then the truth, and to be forgotten; of a measured record it is what the user knows.
        dofs: What the user calls the DOFs, n names; empty: they go by their numbers.
        calibrated: Channels with samples or a calibration of their own. One of a single DOF has a column as well, as it
            is believed to be calibrated and by straight lines where samples are missing: for orders of magnitude,
            spectra and figures. What it says is in its own samples. All other columns are channels as they stand.
        corrected: The same as they felt at the record's times, once that is known.
        responds: Whether a response was measured; otherwise it is what acts on a structure, and no more.
        supports: Name in :data:`pinn_cli.system.quantities.SUPPORT` to (N, S), what was measured of the motion of the
            structure's S supports; a column of NaN where it was not.
        support_names: What the user calls them.
        band: The filter that all channels went through; None: they are as measured.
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
    calibrated: tuple[Channel, ...] = ()
    corrected: tuple[Channel, ...] = ()
    responds: bool = True
    supports: Mapping[str, np.ndarray] = field(default_factory=dict)
    support_names: tuple[str, ...] = ()
    supports_begin: np.ndarray | None = None
    band: BandPass | None = None

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
        numbered = (replace(c, index=i, label=self._label(c)) for i, c in enumerate(self.calibrated))
        object.__setattr__(self, "calibrated", tuple(numbered))
        of_others = [channel for channel in self.calibrated if channel.quantity in RESPONSE_QUANTITIES]
        if self.responds and not self.observed.any() and not of_others:
            raise InputError("record", "no response sensor", "one with a displacement, velocity or acceleration sensor")

    def _check_time(self) -> None:
        steps = np.diff(self.time) if self.time.ndim == 1 else np.zeros(0)
        few = len(steps) + 1 < MINIMUM_SAMPLES
        if few or not (self.step > 0.0 and np.ptp(steps) <= 1e-6 * self.step + clock_rounding(self.time)):
            raise ValueError(f"time must be {MINIMUM_SAMPLES} finite numbers or more that grow by one constant step")

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
            if values.shape != self.time.shape or not (np.isfinite(values).all() or np.isnan(values).all()):
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
    def measured_ground(self) -> np.ndarray | None:
        """(N,), m/s^2, the ground's acceleration where somebody measured it."""
        values = self.ground_acceleration
        return None if values is None or np.isnan(values[0]) else values

    @property
    def misses_ground(self) -> bool:
        """Whether the ground moves and nobody measured how."""
        return self.ground_acceleration is not None and self.measured_ground is None

    @property
    def unmeasured(self) -> str:
        """What acts and nobody measured, in words; "" where there is nothing."""
        if self.misses_ground:
            return "the ground's acceleration"
        unknown = np.flatnonzero(np.isnan(self.force).any(axis=0))
        return f"the force on {self.dof_names(unknown)}" if unknown.size else ""

    @property
    def response_quantities(self) -> tuple[str, ...]:
        """What response sensors measure: of every DOF, and of the ground and supports where they move."""
        ground = () if self.measured_ground is None else (GROUND,)
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
        return all(level_at_end(column, self.step) is not None for block in columns for column in block if column.any())

    def _label(self, channel: Channel) -> str:
        names = self.support_names if channel.quantity in SUPPORT else self.dofs
        return names[channel.dof] if names and channel.weights else ""

    def column(self, quantity: str, number: int) -> Channel:
        """One column as a channel about which nothing is in doubt; its number is counted from 0."""
        weights = {} if quantity == GROUND else {number: 1.0}
        channel = Channel("", quantity, weights, self.time, self.histories(quantity)[:, number])
        gaps = next((corrected.gaps for corrected in self.corrected if corrected.place == channel.place), None)
        return replace(channel, label=self._label(channel), gaps=gaps)

    def plain(self, quantity: str) -> np.ndarray:
        """(channels,) bool: the sensors whose column is all that there is of them."""
        plain = self.sensors(quantity)
        plain[[c.place[1] for c in self.calibrated if c.place[0] == quantity]] = False
        return plain

    def showing(self, channels: Iterable[Channel]) -> Record:
        """The record whose columns show other histories of its channels, these (N,) at its times."""
        return replace(self, **self._columns(channels))

    def _columns(self, channels: Iterable[Channel]) -> dict[str, Any]:
        columns: dict[str, Any] = {}
        for channel in (channel for channel in channels if channel.is_column):
            quantity, number = channel.place
            if quantity not in columns:
                columns[quantity] = self.histories(quantity).copy()
            columns[quantity][:, number] = channel.measured
        if GROUND in columns:
            columns[GROUND] = columns[GROUND][:, 0]
        moved = {quantity: columns.pop(quantity) for quantity in self.supports if quantity in columns}
        return {**columns, "supports": {**self.supports, **moved}}

    def started_at(self, calibrations: Mapping[str, Mapping[str, float]]) -> Record:
        """The record whose channels' unknown numbers start elsewhere; its columns show what they then say."""
        if not {channel.key for channel in self.calibrated} & set(calibrations):
            return self
        again = tuple(channel.started_at(calibrations.get(channel.key, {})) for channel in self.calibrated)
        return replace(self, calibrated=again).showing(c.at(self.time, c.history(self.time)) for c in again)

    @property
    def observed(self) -> np.ndarray:
        """(n,) bool: the DOFs with a displacement, velocity or acceleration sensor."""
        return np.any([self.sensors(quantity) for quantity in RESPONSE_QUANTITIES], axis=0)

    def keep(self, dofs_by_quantity: Mapping[str, Iterable[int]]) -> Record:
        """The record with only the response sensors of some DOFs, counted from 1, by quantity; all others are blanked.

        Raises:
            InputError: No response sensor is left.
            ValueError: A quantity or a DOF that does not exist.
        """
        if not set(dofs_by_quantity) <= set(RESPONSE_QUANTITIES):
            raise ValueError(f"{tuple(dofs_by_quantity)} are not all of {', '.join(RESPONSE_QUANTITIES)}")
        kept = {q: dof_mask(dofs_by_quantity.get(q, ()), self.ndof) for q in RESPONSE_QUANTITIES}
        return self.only(
            lambda channel: channel.quantity not in kept or bool(kept[channel.quantity][list(channel.weights)].all())
        )

    def without_load_cells(self) -> Record:
        """The record in which the force on every forced DOF is unknown."""
        return self.only(lambda channel: channel.quantity != FORCE)

    def only(self, stays: Callable[[Channel], bool]) -> Record:
        """The record with the channels that this is true of; columns of the others are blank. Ground and supports stay.

        Raises:
            InputError: No response sensor is left.
        """
        columns = [self.column(q, i) for q in QUANTITIES for i in np.flatnonzero(self.sensors(q)).tolist()]
        blank = (channel.at(self.time, np.full_like(self.time, np.nan)) for channel in columns if not stays(channel))
        return replace(self, **self._columns(blank), calibrated=tuple(filter(stays, self.calibrated)))

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
            share = samples / repeats.samples
            repeats = replace(repeats, samples=samples, square={q: share * s for q, s in repeats.square.items()})
        ends = float(histories["time"][0]) if first else -np.inf, float(histories["time"][-1])
        calibrated = tuple(shortened for channel in self.calibrated if len((shortened := channel.between(*ends)).time))
        return replace(self, **histories, repeats=repeats, calibrated=calibrated, corrected=(), supports=supports)


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
    """Refuse a ``data.frame`` that does not exist, or one relative to a ground that does not move, for this reason."""
    one_of("data.frame", frame, FRAMES)
    if frame == "relative" and not moves:
        raise InputError("data.frame", frame, "absolute where the ground is at rest", why)


def dof_mask(dofs: Iterable[int], ndof: int) -> np.ndarray:
    """(ndof,) bool from DOFs counted from 1; a ValueError tells of one outside of 1 to ndof."""
    mask = np.zeros(ndof, dtype=bool)
    for dof in dofs:
        if not 1 <= dof <= ndof:
            raise ValueError(f"DOF {dof} is outside 1..{ndof}")
        mask[dof - 1] = True
    return mask
