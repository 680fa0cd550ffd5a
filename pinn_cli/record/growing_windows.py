"""The windows of a record that is still being measured, each as soon as it is there."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pinn_cli.record.arriving import Arriving
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Measurements
from pinn_cli.record.windows import Grid, RecordWindows, Window, grid_of, window_of
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import positive_number
from pinn_cli.system.structure import Structure


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


class GrowingWindows(RecordWindows):
    """Windows of a file that grows, or of files that arrive in a folder.

    Args:
        data: What is what in them.
        connections: Names of the structure's.
        length, overlap: See :class:`RecordWindows`.
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
        super().__init__(length, overlap)
        self.data, self.connections, self.patience = data, connections, patience
        self.sleep, self.now = sleep, now
        self._grid: Grid | None = None

    @cached_property
    def arriving(self) -> Arriving:
        """What has come."""
        return self.data.arriving()

    def after(self, done: int) -> Iterator[Window]:
        """See :meth:`RecordWindows.after`; ends with what is left when nothing has come for long enough."""
        since = self.now()
        while True:
            came = self.arriving.read()
            while (window := self._next(done + 1)) is not None:
                yield window
                done, came = window.number, True
            if came:  # there may be more by now
                since = self.now()
                continue
            if self._has_ended() or self._is_idle(since):
                last = self._last(done + 1)
                if last is not None:
                    yield last
                return
            self.sleep(self.patience.poll)

    def measure(self, true: Structure, window: Window) -> Measurements:
        """See :meth:`RecordWindows.measure`."""
        assert self._grid is not None
        return window_of(self.data, self.arriving.clock, window, self._grid.step, self.connections, true.ndof)

    def _is_idle(self, since: float) -> bool:
        idle = self.patience.until_idle
        return idle is not None and self.now() - since >= idle

    def _has_ended(self) -> bool:
        """Whether the record goes on beyond what is to be used of it."""
        stop, came = self.data.stop, self.arriving.time
        return stop is not None and len(came) > 0 and float(came[-1]) >= stop

    @property
    def _time(self) -> np.ndarray:
        """(N,), s, of the samples that are used, as far as they are kept."""
        came = self.arriving.time
        first = -np.inf if self.data.start is None else self.data.start
        last = np.inf if self.data.stop is None else self.data.stop
        return came[(came >= first) & (came <= last)]

    def _next(self, number: int) -> Window | None:
        """A window that is there as a whole; None while it is not."""
        own = self._time
        if self._grid is None:
            if len(own) == 0 or own[-1] <= own[0] + self.length:
                return None
            self._grid = grid_of(self.length, self.overlap, own)
        window = self._grid.window(number)
        self.arriving.forget_before(window.start - 0.5 * self._grid.step)
        return window if len(own) and self._grid.is_reached(window, float(own[-1])) else None

    def _last(self, number: int) -> Window | None:
        """What is left, as a window that hands over to none."""
        own = self._time
        if len(own) == 0:
            hint = f"nothing has come: {self.arriving.path}"
            raise InputError("data.path", self.arriving.path.name, "a file that grows, or a folder with files", hint)
        self._grid = self._grid or grid_of(self.length, self.overlap, own)
        return self._grid.last(number, float(own[-1]))
