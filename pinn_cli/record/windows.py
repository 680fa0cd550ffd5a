"""A long record window by window: where windows begin, and what was measured in each, as soon as it is there.

    |<------ window ------>|
    |             |<------ window ------>|
    |             |        |    |<------ window ------>|
               hand-over       hand-over

A window hands over to the next one where that begins, an overlap before its own end. What it says of the motion up to
there knows of the samples behind it as well, so that no part of the response lies at an edge.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pinn_cli.record.arriving import Arriving
from pinn_cli.record.clock import Clock
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import MINIMUM_SAMPLES, Measurements, Truth
from pinn_cli.record.simulated import Simulated
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import non_negative_number, positive_number
from pinn_cli.system.structure import Structure

WINDOW_SETTING, OVERLAP = "data.window", "data.overlap"
# Of a window, where nobody says how much of it the next one begins with.
OVERLAP_SHARE = 1.0 / 6.0
# Of the steps between samples, over their median: longer ones are gaps.
GAP = 1.5
# Of a window at most: what three windows have in common would be in two of them for nothing.
LARGEST_SHARE = 0.5


@dataclass(frozen=True)
class Window:
    """One window of a record.

    Attributes:
        number: Counted from 1.
        start, stop: Times of its first and last sample, s.
        hand_over: Time of the first sample of the next one, s; None of the last window.
    """

    number: int
    start: float
    stop: float
    hand_over: float | None = None

    @property
    def name(self) -> str:
        """As people say it."""
        return f"window {self.number} ({self.start:.9g} to {self.stop:.9g} s)"


@dataclass(frozen=True)
class Grid:
    """Where the windows of a record begin: at whole numbers of samples from its first one.

    Attributes:
        first: Time of the first sample, s.
        step: From sample to sample, s.
        length, overlap: Of the windows, in samples from the first of each to the last.
    """

    first: float
    step: float
    length: int
    overlap: int

    @classmethod
    def of(cls, length: float, overlap: float | None, time: np.ndarray) -> Grid:
        """Of windows so many seconds long, from times (N,), s, of the first window or more; too few are refused."""
        times = time[: int(np.searchsorted(time, time[0] + length, side="right"))]
        if len(times) < MINIMUM_SAMPLES:
            hint = f"the first {length:g} s hold {len(times)} samples"
            raise InputError(WINDOW_SETTING, length, f"windows of at least {MINIMUM_SAMPLES} samples", hint)
        steps = np.diff(times)
        # Times are printed with few digits: one step is off by much, all together are not. Gaps are no steps.
        step = float(np.mean(steps[steps < GAP * np.median(steps)]))
        overlap = OVERLAP_SHARE * length if overlap is None else overlap
        return cls(float(times[0]), step, round(length / step), round(overlap / step))

    def window(self, number: int) -> Window:
        """A window that is no last one."""
        start = (number - 1) * (self.length - self.overlap)
        at = [start, start + self.length, start + self.length - self.overlap]
        first, last, after = (self.first + sample * self.step for sample in at)
        return Window(number, first, last, after)

    def last(self, number: int, stop: float) -> Window | None:
        """What is left for a last window of a record that ends at ``stop``, s; None if those before have it all."""
        before, window = self.window(number - 1), self.window(number)
        samples = round((stop - window.start) / self.step) + 1
        if (number > 1 and stop <= before.stop + 0.5 * self.step) or samples < MINIMUM_SAMPLES:
            return None
        return Window(number, window.start, stop)

    def is_reached(self, window: Window, time: float) -> bool:
        """Whether a record that has come to a time, s, has the whole window."""
        return time > window.stop - 0.5 * self.step

    def all(self, stop: float) -> list[Window]:
        """The windows of a whole record that ends at ``stop``, s."""
        windows: list[Window] = []
        while self.is_reached(window := self.window(len(windows) + 1), stop):
            windows.append(window)
        last = self.last(len(windows) + 1, stop)
        return [*windows[:-1], replace(windows[-1], hand_over=None)] if last is None else [*windows, last]


def checked_lengths(window: object, overlap: object) -> tuple[float, float | None]:
    """``data.window`` and ``data.overlap``, s; refused where one is no usable number, or the overlap is too long."""
    length = positive_number(WINDOW_SETTING, window)
    if overlap is None:
        return length, None
    seconds = non_negative_number(OVERLAP, overlap)
    if seconds > LARGEST_SHARE * length:
        allowed = f"at most half of {WINDOW_SETTING}={length:g}"
        raise InputError(OVERLAP, seconds, allowed, "the next window begins so long before the end of this one")
    return length, seconds


class RecordWindows(ABC):
    """A record that is read window by window.

    Args:
        length: Of a window, s.
        overlap: Of two, s; None: `OVERLAP_SHARE` of the length.
    """

    def __init__(self, length: float, overlap: float | None) -> None:
        self.lengths = length, overlap

    @abstractmethod
    def after(self, done: int) -> Iterator[Window]:
        """The windows that follow on the first so many, each as soon as it is there.

        Raises:
            InputError: The record cannot be read, or has no window.
        """

    @abstractmethod
    def measure(self, true: Structure, window: Window) -> Measurements:
        """The record of a window, with every sensor that exists, and the truth as far as it is known.

        Raises:
            InputError: A cell that cannot be used, a sensor that shows one value throughout.
        """


class MeasuredWindows(RecordWindows):
    """Windows of files; their columns are read once, and a window of them is used at a time.

    Args:
        data: What is what in them.
        connections: Names of the structure's.
        length, overlap: See :class:`RecordWindows`.
    """

    def __init__(self, data: MeasuredData, connections: list[str], length: float, overlap: float | None) -> None:
        super().__init__(length, overlap)
        self.data, self.connections = data, connections
        self.grid: Grid | None = None

    @cached_property
    def _whole(self) -> Clock:
        return self.data.clock()

    @property
    def clock(self) -> Clock:
        """The columns, as far as they are kept."""
        return self._whole

    def after(self, done: int) -> Iterator[Window]:
        """See :meth:`RecordWindows.after`."""
        time = self.data.used(self.clock)
        self.grid = Grid.of(*self.lengths, time)
        yield from self.grid.all(float(time[-1]))[done:]

    def measure(self, true: Structure, window: Window) -> Measurements:
        """See :meth:`RecordWindows.measure`."""
        assert self.grid is not None
        half = 0.5 * self.grid.step
        data = replace(self.data, start=window.start - half, stop=window.stop + half)
        return data.measure(true.ndof, self.connections, self.clock)


class SimulatedWindows(RecordWindows):
    """Windows of a simulated record, which is simulated once."""

    def __init__(self, simulated: Simulated, length: float, overlap: float | None) -> None:
        super().__init__(length, overlap)
        self.simulated = simulated
        self._whole: Measurements | None = None

    def after(self, done: int) -> Iterator[Window]:
        """See :meth:`RecordWindows.after`."""
        time = self.simulated.simulation.time
        yield from Grid.of(*self.lengths, time).all(float(time[-1]))[done:]

    def measure(self, true: Structure, window: Window) -> Measurements:
        """See :meth:`RecordWindows.measure`."""
        self._whole = self._whole or self.simulated.measure(true)
        record, truth = self._whole.record, self._whole.truth
        ends = window.start - 0.5 * record.step, window.stop + 0.5 * record.step
        first, stop = np.searchsorted(record.time, ends).tolist()
        return Measurements(record.part(first, stop), Truth(truth.response.part(first, stop), truth.parameters))


@dataclass(frozen=True)
class Patience:
    """How a record is waited for.

    Attributes:
        poll: Seconds from one look at it to the next.
        until_idle: Seconds without anything new after which it is taken to have ended; None: it never is.

    Raises:
        InputError: Naming ``follow.<setting>``.
    """

    poll: float = 1.0
    until_idle: float | None = None

    def __post_init__(self) -> None:
        positive_number("follow.poll", self.poll)
        if self.until_idle is not None:
            positive_number("follow.until_idle", self.until_idle)


class GrowingWindows(MeasuredWindows):
    """Windows of a file that grows, or of files that arrive in a folder.

    Args:
        data, connections, length, overlap: See :class:`MeasuredWindows`.
        patience: How the record is waited for.
        sleep: Called with seconds while there is nothing to do.
        now: A clock, s.
    """

    def __init__(
        self,
        data: MeasuredData,
        connections: list[str],
        length: float,
        overlap: float | None,
        patience: Patience,
        sleep: Callable[[float], None] = time.sleep,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(data, connections, length, overlap)
        self.patience, self.sleep, self.now = patience, sleep, now

    @cached_property
    def arriving(self) -> Arriving:
        """What has come."""
        return self.data.arriving()

    def after(self, done: int) -> Iterator[Window]:
        """See :meth:`RecordWindows.after`; ends with what is left when nothing has come for long enough."""
        since, idle, end = self.now(), self.patience.until_idle, self.data.stop
        while True:
            came = self.arriving.read()
            while (window := self._next(done + 1)) is not None:
                yield window
                done, came = window.number, True
            if came:  # there may be more by now
                since = self.now()
                continue
            time = self.arriving.time
            has_ended = end is not None and len(time) > 0 and float(time[-1]) >= end
            if has_ended or (idle is not None and self.now() - since >= idle):
                break
            self.sleep(self.patience.poll)
        times = self._time
        if len(times) == 0:
            hint = f"nothing has come: {self.arriving.path}"
            raise InputError("data.path", self.arriving.path.name, "a file that grows, or a folder with files", hint)
        self.grid = self.grid or Grid.of(*self.lengths, times)
        last = self.grid.last(done + 1, float(times[-1]))
        if last is not None:  # it hands over to none
            yield last

    @property
    def clock(self) -> Clock:
        """See :attr:`MeasuredWindows.clock`."""
        return self.arriving.clock

    @property
    def _time(self) -> np.ndarray:
        """(N,), s, of the samples that are used, as far as they are kept."""
        came = self.arriving.time
        first = -np.inf if self.data.start is None else self.data.start
        last = np.inf if self.data.stop is None else self.data.stop
        return came[(came >= first) & (came <= last)]

    def _next(self, number: int) -> Window | None:
        """A window that is there as a whole; None while it is not."""
        times = self._time
        if self.grid is None:
            if len(times) == 0 or times[-1] <= times[0] + self.lengths[0]:
                return None
            self.grid = Grid.of(*self.lengths, times)
        window = self.grid.window(number)
        self.arriving.forget_before(window.start - 0.5 * self.grid.step)
        return window if len(times) and self.grid.is_reached(window, float(times[-1])) else None
