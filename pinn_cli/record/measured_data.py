"""A record that someone measured: which column of a file is what (``data=csv``, ``data=mat`` and so on)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.clock import TIME_UNITS
from pinn_cli.record.decimation import decimate
from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.table import Table
from pinn_cli.record.measured_files import MeasuredFiles
from pinn_cli.record.record import (
    GROUND,
    INTERSAMPLE,
    MINIMUM_SAMPLES,
    QUANTITIES,
    RESPONSE_QUANTITIES,
    Frame,
    Intersample,
    Measurements,
    Record,
    Response,
    Truth,
    check_frame,
    dof_mask,
)
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import (
    entries,
    finite_number,
    is_whole_number,
    one_of,
    positive_number,
    whole_number,
)
from pinn_cli.settings.paths import located


@dataclass(frozen=True)
class MeasuredData:
    """Which column of a file is what, and which part of it is used.

    Attributes:
        path: Of the file, or of several whose samples stand on one clock; a relative one starts at ``base``, and ``~``
            is home.
        time: Column of the times, uniform within the window; None: ``t``, unless ``sampling_rate`` is given or
            the format tells times of its own.
        sampling_rate: Hz, in place of a column of times; the first sample is then at 0 s.
        time_unit: Of that column: s, ms or us.
        force: DOF (from 1) to column, N; None instead of a column for a force that acts but is not measured. DOFs that
            are not listed are known to be unforced.
        displacement, velocity, acceleration: DOF to column, m, m/s, m/s^2.
        ground_acceleration: Column of the ground's acceleration, m/s^2; None: the ground is at rest.
        frame: What the accelerometers measure where the ground moves: ``absolute``, or ``relative`` to the ground.
        holdout: DOFs whose columns the estimator never sees: they go into the truth, to score it.
        start, stop: Of the window, s, both included; None: the file's ends.
        decimate: Keep every so manieth sample of the window, after an anti-alias filter.
        intersample: How the force behaves between the samples.
        base: The directory the user started the command in; None: the current one.
        kind: The name of the config group's choice.
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
    intersample: Intersample = "band_limited"
    ground_acceleration: str | None = None
    frame: Frame = "absolute"
    base: Path | None = None
    kind: str = "csv"
    format: FileFormat = field(default_factory=CsvFormat)
    sampling_rate: float | None = None
    time_unit: str = "s"

    def __post_init__(self) -> None:
        paths = [self.path] if isinstance(self.path, str) else entries(self.path)
        if not paths or not all(isinstance(path, str) and path for path in paths):
            raise InputError(
                "data.path", self.path, f"given: data={self.kind} reads a file of yours, or a list of files"
            )
        self._check_clock()
        for quantity in QUANTITIES:
            object.__setattr__(self, quantity, _checked_columns(quantity, getattr(self, quantity)))
        object.__setattr__(self, "holdout", _checked_holdout(self.holdout))
        self._check_window()
        one_of("data.intersample", self.intersample, INTERSAMPLE)
        if self.decimate > 1 and self.intersample == "zero_order_hold":
            hint = "a filtered force is no longer held; take data.intersample=band_limited"
            raise InputError("data.decimate", self.decimate, "1 with data.intersample=zero_order_hold", hint)
        self._check_ground()
        self._check_sensors()
        self._check_columns_differ()

    def measure(self, ndof: int) -> Measurements:
        """The record of the columns that are not held out, and as the truth those that are; the rest of it is NaN.

        Raises:
            InputError: A DOF outside 1..ndof; a file, column or cell that cannot be used; too few samples; a response
                sensor that reads one value throughout.
        """
        self._check_dofs(ndof)
        time, values = self._read()
        self._check_alive(values)
        seen, truth = Response.unknown(time, ndof), Response.unknown(time, ndof)
        unforced = ~dof_mask(self.force, ndof)
        seen.force[:, unforced] = 0.0
        ground = values.pop((GROUND, 0), None)
        for (quantity, dof), column in values.items():
            target = truth if dof in self.holdout else seen
            getattr(target, quantity)[:, dof - 1] = column
        seen = replace(seen, ground_acceleration=ground)
        record = Record(**seen.measurable, unforced=unforced, intersample=self.intersample, frame=self.frame)
        return Measurements(record, Truth(truth))

    @property
    def _columns(self) -> dict[tuple[str, int], str]:
        """Quantity and DOF to the name of the column; the ground's has DOF 0."""
        columns = {
            (quantity, dof): column
            for quantity in QUANTITIES
            for dof, column in getattr(self, quantity).items()
            if column is not None
        }
        return columns if self.ground_acceleration is None else {**columns, (GROUND, 0): self.ground_acceleration}

    def _check_alive(self, values: Mapping[tuple[str, int], np.ndarray]) -> None:
        """A response sensor that reads one value throughout has seen nothing; a force may well be zero."""
        for (quantity, dof), column in values.items():
            if quantity != "force" and np.ptp(column) == 0.0:
                name = self._columns[quantity, dof]
                hint = f"every sample of it is {column[0]:g}: a dead sensor? Leave it out of data.{quantity}"
                raise InputError(_setting(quantity, dof), repr(name), "a column that varies", hint)

    def _read(self) -> tuple[np.ndarray, dict[tuple[str, int], np.ndarray]]:
        """Times (N,) of the window after decimation, and by quantity and DOF the columns (N,)."""
        columns = self._columns
        clock = self._files.read({_setting(*place): column for place, column in columns.items()})
        first, last = self._window(clock.time)
        time = clock.uniform(first, last)
        values = np.stack([self._samples(clock.table, column, first, last) for column in columns.values()], axis=1)
        return time[:: self.decimate], dict(zip(columns, decimate(values, self.decimate).T, strict=True))

    @staticmethod
    def _samples(table: Table, column: str, first: int, last: int) -> np.ndarray:
        """The column's numbers in rows first..last (excluded), every one of them there."""
        values = table.numbers(column, first, last)
        table.refuse_gaps(column, values, first)
        return values

    @property
    def _files(self) -> MeasuredFiles:
        paths = tuple(located(path, self.base or Path.cwd()) for path in self._paths)
        return MeasuredFiles(paths, self.format, self.time, self.sampling_rate, self.time_unit)

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

    def _check_window(self) -> None:
        for setting in ("start", "stop"):
            if getattr(self, setting) is not None:
                finite_number(f"data.{setting}", getattr(self, setting))
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise InputError("data.start", self.start, f"before data.stop={self.stop}")
        whole_number("data.decimate", self.decimate, least=1)

    def _check_clock(self) -> None:
        if self.time is not None and (not isinstance(self.time, str) or not self.time):
            raise InputError("data.time", self.time, "null or the name of a column")
        one_of("data.time_unit", self.time_unit, list(TIME_UNITS))
        if self.sampling_rate is not None:
            positive_number("data.sampling_rate", self.sampling_rate)
            if self.time is not None:
                allowed = "null where data.time names a column of times"
                raise InputError(
                    "data.sampling_rate", self.sampling_rate, allowed, "either says when samples were taken"
                )

    def _check_ground(self) -> None:
        column = self.ground_acceleration
        if column is not None and (not isinstance(column, str) or not column):
            raise InputError(f"data.{GROUND}", column, "null or the name of a column")
        check_frame(self.frame, column is not None, f"data.{GROUND} is not given")
        if column is not None and self.intersample == "zero_order_hold":
            allowed = f"band_limited with data.{GROUND}"
            raise InputError("data.intersample", self.intersample, allowed, "nothing holds the ground between samples")

    def _check_sensors(self) -> None:
        measured = {dof for quantity in RESPONSE_QUANTITIES for dof in getattr(self, quantity)}
        if not measured:
            settings = ", ".join(f"data.{quantity}" for quantity in RESPONSE_QUANTITIES)
            raise InputError(settings, "{}", "a map of DOF: column in at least one of them")
        forces = {dof for dof, column in self.force.items() if column is not None}
        for dof in self.holdout:
            if dof not in measured | forces:
                raise InputError("data.holdout", dof, "a DOF with a column", "there is nothing to score it against")
        if not measured - set(self.holdout):
            allowed = "such that a displacement, velocity or acceleration column is left"
            raise InputError("data.holdout", list(self.holdout), allowed)

    def _check_columns_differ(self) -> None:
        files = self._files
        times = {files.time_column(path) for path in files.paths} - {None}
        places = {str(time): "data.time" for time in times}
        for place, column in self._columns.items():
            if column in places:
                raise InputError(_setting(*place), repr(column), f"another column than {places[column]}")
            places[column] = _setting(*place)

    def _check_dofs(self, ndof: int) -> None:
        for quantity in QUANTITIES:
            for dof in getattr(self, quantity):
                if not 1 <= dof <= ndof:
                    raise InputError(f"data.{quantity}", dof, f"a DOF between 1 and system.ndof={ndof}")


def _setting(quantity: str, dof: int) -> str:
    """Where the column of a quantity and DOF is given."""
    return f"data.{quantity}" if quantity == GROUND else f"data.{quantity}.{dof}"


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
