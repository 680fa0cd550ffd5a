"""A record that someone measured: which column of a file is what (``data=csv``, ``data=mat`` and so on)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pinn_cli.record.arriving import Arriving
from pinn_cli.record.between_samples import BETWEEN_SAMPLES, FIRST_ORDER_HOLD
from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels
from pinn_cli.record.clock import TIME_UNITS, Clock, MeasuredFiles
from pinn_cli.record.data_channels import CHANNELS, DataChannel, data_channels
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.file_format import FileFormat
from pinn_cli.record.record import MINIMUM_SAMPLES, Frame, Measurements, Record, Truth, check_frame, dof_mask
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.record.sampled import sampled
from pinn_cli.record.spectrum import BandPass, checked_band
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import (
    entries,
    finite_number,
    is_whole_number,
    located,
    one_of,
    positive_number,
    whole_number,
)
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT

# Part of a step by which a sample may be off the time where it scores.
OFF = 0.05
# Instead of a column of the ground's acceleration.
UNMEASURED = "unmeasured"


@dataclass(frozen=True)
class MeasuredData:
    """Which column of a file is what, and which part of it is used.

    Attributes:
        path: Of the file, or of several whose samples stand on one clock; a relative one starts at ``base``, and ``~``
            is home.
        time: Column of the times, uniform within the window; None: that which is called ``t``, ``time`` or so, unless
            ``sampling_rate`` is given or the format tells times of its own.
        sampling_rate: Hz, in place of a column of times; the first sample is then at 0 s.
        time_unit: Of that column: s, ms or us; None: what the file's header says, else s.
        force: DOF (from 1) to column, N; None instead of a column for a force that acts but is not measured. DOFs that
            are not listed are known to be unforced.
        displacement, velocity, acceleration: DOF to column, m, m/s, m/s^2.
        ground_acceleration: Column of the ground's acceleration, m/s^2; ``unmeasured``: it moves anyhow; None: it is at
            rest.
        frame: What the accelerometers measure where the ground moves: ``absolute``, or ``relative`` to the ground.
        holdout: DOFs whose response columns the estimator never sees: they go into the truth, to score it. Their forces
            are inputs, and stay.
        start, stop: Of the window, s, both included; None: the file's ends.
        decimate: Keep every so manieth sample of the window, after an anti-alias filter.
        band: Lower and upper edge, Hz: all channels alike are filtered to it, and as many samples kept as it takes;
            None: they stay as they were measured.
        intersample: How what acts behaves between the samples, one of :data:`BETWEEN_SAMPLES`; None: band-limited,
            unless its samples lie on straight lines.
        base: The directory the user started the command in; None: the current one.
        kind: The name of the config group's choice.
        channels: Name of a channel to what it is, the long form: see
            :class:`pinn_cli.record.data_channels.DataChannel`.
        validation: Another record, or a segment of the same, that the identified system is tried on: see
            :class:`pinn_cli.record.validation_data.ValidationData`.
        responds: Whether a response was measured; of a prediction only what acts is, and columns that are held out.
        missing: A number that marks missing values, or a list of some; None: see :meth:`Table.with_gaps`.
        format: How numbers lie in the file; where its suffix is that of another format, that one's settings by default.

    Raises:
        InputError: Naming ``data.<setting>``.
    """

    path: str | Sequence[str]
    time: str | None = None
    force: Mapping[int, str | None] = field(default_factory=dict)
    displacement: Mapping[int, str] = field(default_factory=dict)
    velocity: Mapping[int, str] = field(default_factory=dict)
    acceleration: Mapping[int, str] = field(default_factory=dict)
    holdout: Sequence[int] = ()
    start: float | None = None
    stop: float | None = None
    decimate: int = 1
    intersample: Annotated[str, BETWEEN_SAMPLES] | None = None
    ground_acceleration: str | None = None
    frame: Frame = "absolute"
    base: Path | None = None
    kind: str = "csv"
    format: FileFormat = field(default_factory=CsvFormat)
    sampling_rate: float | None = None
    time_unit: Annotated[str, tuple(TIME_UNITS)] | None = None
    channels: Annotated[Any, CHANNELS] = None
    validation: Any = None
    responds: bool = True
    band: Any = None
    missing: Any = None

    def __post_init__(self) -> None:
        for quantity in QUANTITIES:
            object.__setattr__(self, quantity, _checked_columns(quantity, getattr(self, quantity)))
        object.__setattr__(self, "channels", data_channels(self.channels))
        object.__setattr__(self, "holdout", _checked_holdout(self.holdout))
        object.__setattr__(self, "band", checked_band(self.band))
        whole_number("data.decimate", self.decimate, least=1)
        for setting, is_usable in (
            ("start", finite_number),
            ("stop", finite_number),
            ("sampling_rate", positive_number),
        ):
            if getattr(self, setting) is not None:
                is_usable(f"data.{setting}", getattr(self, setting))
        for setting, values in (("time_unit", list(TIME_UNITS)), ("intersample", BETWEEN_SAMPLES)):
            if getattr(self, setting) is not None:
                one_of(f"data.{setting}", getattr(self, setting), values)
        for is_wrong, *told in self._refusals():
            if is_wrong:
                raise InputError(*told)

    def _refusals(self) -> Iterator[tuple[bool, str, Any, str, str]]:
        """What does not go together, one after the other: whether it is so, setting, value, what is allowed, a hint."""
        paths = [self.path] if isinstance(self.path, str) else entries(self.path)
        named = bool(paths) and all(isinstance(path, str) and path for path in paths)
        allowed = f"given: data={self.kind} reads a file of yours, or a list of files"
        yield not named, "data.path", self.path, allowed, ""
        for setting, instead in (("time", "null"), (GROUND, f"null, {UNMEASURED}")):
            column = getattr(self, setting)
            named = column is None or (isinstance(column, str) and bool(column))
            yield not named, f"data.{setting}", column, f"{instead} or the name of a column", ""
        twice = self.sampling_rate is not None and self.time is not None
        yield twice, "data.sampling_rate", self.sampling_rate, "null where data.time names a column of times", ""
        backwards = self.start is not None and self.stop is not None and self.start >= self.stop
        yield backwards, "data.start", self.start, f"before data.stop={self.stop}", ""
        held, thinned = self.intersample == "zero_order_hold", self.decimate > 1
        allowed = "1 with data.intersample=zero_order_hold"
        yield held and thinned, "data.decimate", self.decimate, allowed, "a filtered force is no longer held"
        other = f"data.decimate={self.decimate}" if thinned else "data.intersample=zero_order_hold"
        banded = self.band is not None and (held or thinned)
        yield banded, "data.band", list(self.band or ()), f"null beside {other}", "its filter says both"
        sensors = [channel.sensor for channel in self._every_channel]
        moves = self.ground_acceleration == UNMEASURED or any(sensor.quantity == GROUND for sensor in sensors)
        check_frame(self.frame, moves, f"data.{GROUND} is not given")
        allowed = f"band_limited or {FIRST_ORDER_HOLD} with data.{GROUND}"
        yield moves and held, "data.intersample", self.intersample, allowed, "nothing holds the ground between samples"
        sensors = [sensor for sensor in sensors if sensor.quantity in RESPONSE_QUANTITIES]
        response, hidden = [{dof + 1 for dof in sensor.weights} for sensor in sensors], set(self.holdout)
        settings = ", ".join(f"data.{quantity}" for quantity in RESPONSE_QUANTITIES)
        yield self.responds and not response, settings, "{}", "a map of DOF: column in at least one of them", ""
        for dof in hidden - set().union(*response):
            allowed = "a DOF with a column of its response"
            yield True, "data.holdout", dof, allowed, "there is nothing to score it against"
        left = not self.responds or not all(dofs & hidden for dofs in response)
        allowed = "such that a displacement, velocity or acceleration column is left"
        yield not left, "data.holdout", list(self.holdout), allowed, ""
        alone = not self.responds or any(sensor.is_column for sensor in sensors)
        allowed = "one displacement, velocity or acceleration at least that feels one DOF alone"
        hint = "the size and the band of the motion are read off it"
        yield not alone, "data.channels", "drifts and weighted sums only", allowed, hint
        files, places = self._files, dict[str, str]()
        for channel in self._every_channel:
            of_times = files.takes_for_times(channel.column)
            place = places.setdefault(channel.column, "data.time" if of_times else channel.setting)
            yield place != channel.setting, channel.setting, repr(channel.column), f"another column than {place}", ""

    def measure(self, ndof: int, connections: Sequence[str] = (), clock: Clock | None = None) -> Measurements:
        """The record of the channels that are not held out, and as the truth those that are; the rest of it is NaN.

        The file's columns are read now, unless they come with a clock.

        Raises:
            InputError: A DOF outside 1..ndof; a file, column or cell that cannot be used; too few samples; a response
                sensor that reads one value throughout.
        """
        self._check_dofs(ndof)
        clock = self.clock() if clock is None else clock
        window = self._window(clock.time)
        thinned: int | BandPass = self.decimate
        if self.band is not None:
            thinned = BandPass.of(self.band, len(clock.time), clock.step(*window))
        taken = sampled(self._every_channel, clock, window, thinned, connections, self.intersample)
        time = taken.time
        seen, truth = Response.unknown(time, ndof), Response.unknown(time, ndof)
        sensors = [channel.sensor for channel in self.channels]
        forced = [*self.force, *(dof + 1 for sensor in sensors if sensor.quantity == FORCE for dof in sensor.weights)]
        unforced = ~dof_mask(forced, ndof)
        seen.force[:, unforced] = 0.0
        supports: dict[str, np.ndarray] = {}
        moving = max((sensor.dof + 1 for sensor in sensors if sensor.quantity in SUPPORT), default=0)
        for (quantity, number), column in taken.columns.items():
            if quantity in SUPPORT:
                supports.setdefault(quantity, np.full((len(time), moving), np.nan))[:, number] = column
            elif quantity != GROUND:
                getattr(seen, quantity)[:, number] = column
        nobody_knows = np.full(len(time), np.nan) if self.ground_acceleration == UNMEASURED else None
        seen = replace(seen, ground_acceleration=taken.columns.get((GROUND, 0), nobody_knows))
        record = Record(
            **seen.measurable,
            unforced=unforced,
            intersample=taken.intersample,
            assumed=taken.assumed,
            frame=self.frame,
            calibrated=taken.calibrated,
            responds=self.responds,
            band=taken.band,
            supports=supports,
            support_names=tuple(str(i + 1) for i in range(moving)),
        )
        hidden = [channel for channel in (*channels(record), *record.calibrated) if self._hides(channel)]
        for channel in hidden:
            if not channel.feels_one:
                allowed = "DOFs whose every channel measures that DOF alone"
                raise InputError("data.holdout", list(self.holdout), allowed, f"channel {channel.key} feels others too")
            if channel.is_column:
                getattr(truth, channel.quantity)[:, channel.dof] = _scored_by(channel, time, self.holdout)
        return Measurements(record.only(lambda channel: not self._hides(channel)), Truth(truth))

    def _hides(self, channel: Channel) -> bool:
        return channel.quantity in RESPONSE_QUANTITIES and any(dof + 1 in self.holdout for dof in channel.weights)

    @cached_property
    def _every_channel(self) -> tuple[DataChannel, ...]:
        """Those of ``data.channels`` and those of the short form."""
        short = [
            DataChannel.of_column(f"data.{quantity}.{dof}", column, quantity, dof)
            for quantity in QUANTITIES
            for dof, column in getattr(self, quantity).items()
            if column is not None
        ]
        if self.ground_acceleration not in (None, UNMEASURED):
            short.append(DataChannel.of_column(f"data.{GROUND}", self.ground_acceleration, GROUND))
        return (*short, *self.channels)

    def clock(self) -> Clock:
        """The columns of the file that are used, and when they were sampled.

        Raises:
            InputError: The file, or one of its columns, cannot be read.
        """
        return self._files.read({channel.setting: channel.column for channel in self._every_channel})

    def arriving(self) -> Arriving:
        """The same of a file that grows, or of a folder into which files arrive; several paths are refused."""
        if len(self._paths) > 1:
            hint = "their samples stand on one clock: join them, or let files arrive in a folder"
            raise InputError("data.path", f"{len(self._paths)} files", "a file that grows, or a folder", hint)
        return Arriving(self._files, {channel.setting: channel.column for channel in self._every_channel})

    def used(self, clock: Clock) -> np.ndarray:
        """(N,), s, the times between start and stop; too few are refused."""
        return clock.time[slice(*self._window(clock.time))]

    @property
    def _files(self) -> MeasuredFiles:
        paths = tuple(located(path, self.base or Path.cwd()) for path in self._paths)
        return MeasuredFiles(paths, self.format, self.time, self.sampling_rate, self.time_unit, self.missing)

    @property
    def _paths(self) -> tuple[str, ...]:
        return (self.path,) if isinstance(self.path, str) else tuple(self.path)

    def _window(self, time: np.ndarray) -> tuple[int, int]:
        """Rows first..last (excluded) between start and stop."""
        first = 0 if self.start is None else int(np.searchsorted(time, self.start, side="left"))
        last = len(time) if self.stop is None else int(np.searchsorted(time, self.stop, side="right"))
        kept = math.ceil(max(last - first, 0) / self.decimate)
        if kept < MINIMUM_SAMPLES:
            extent = f" from {time[0]:g} to {time[-1]:g} s" if len(time) else ""
            file = f"{', '.join(Path(path).name for path in self._paths)} has {len(time)} rows{extent}"
            hint = f"{file}; after data.decimate={self.decimate} {kept} of them are left"
            allowed = f"a window of at least {MINIMUM_SAMPLES} samples"
            raise InputError("data.start, data.stop", f"{self.start}, {self.stop}", allowed, hint)
        return first, last

    def _check_dofs(self, ndof: int) -> None:
        for dof in self.force:  # of one that acts unmeasured there is no channel
            if not 1 <= dof <= ndof:
                raise InputError("data.force", dof, f"a DOF between 1 and system.ndof={ndof}")
        for channel in (channel for channel in self._every_channel if channel.sensor.quantity not in SUPPORT):
            for dof in channel.sensor.weights:
                if dof >= ndof:
                    setting = channel.setting if channel in self.channels else f"data.{channel.sensor.quantity}"
                    raise InputError(setting, dof + 1, f"a DOF between 1 and system.ndof={ndof}")


def _checked_columns(quantity: str, columns: Any) -> dict[int, str | None]:
    """DOF to column. A DOF may come as text, which is what ``data.force.1=f1`` on the command line makes of it."""
    setting = f"data.{quantity}"
    if columns is None:
        return {}
    if not isinstance(columns, Mapping):
        raise InputError(setting, columns, "a map of DOF: column", f"e.g. {setting}={{1: 'sensor 1'}}")
    checked: dict[int, str | None] = {}
    for key, column in columns.items():
        whole = is_whole_number(key) or (isinstance(key, str) and key.isdecimal())
        if not whole or int(key) in checked:
            raise InputError(setting, key, "a map whose keys are different DOFs, counted from 1")
        if not isinstance(column, str) and not (column is None and quantity == "force"):
            raise InputError(f"{setting}.{key}", column, "the name of a column")
        checked[int(key)] = column
    return checked


def _checked_holdout(holdout: Any) -> tuple[int, ...]:
    dofs = entries(holdout)
    if not isinstance(holdout, Sequence) or isinstance(holdout, str) or not all(is_whole_number(dof) for dof in dofs):
        raise InputError("data.holdout", holdout, "a list of DOFs, counted from 1")
    return tuple(dict.fromkeys(int(dof) for dof in dofs))


def _scored_by(channel: Channel, time: np.ndarray, holdout: Sequence[int]) -> np.ndarray:
    """What a sensor that is held out knows of the truth (N,), by a known calibration; NaN where it has no sample."""
    place, off = channel.places(time)
    is_known = all(channel.number(kind).is_known for kind in channel.calibration)
    if not is_known or channel.number("delay").value or np.abs(off).max() > OFF:
        allowed = "DOFs whose channels have a known calibration, no delay, and samples at even times"
        raise InputError("data.holdout", list(holdout), allowed, f"nothing else scores channel {channel.key}")
    truth = np.full(len(time), np.nan)
    truth[place] = channel.corrected_samples()[1]
    return truth
