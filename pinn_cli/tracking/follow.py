"""A run under the eyes of a tracker: its rows as they come, what came of it, and how it ended.

A tracker may fail, when its disk is full or its server is gone; the run goes on, and the log says so once. Only one
that cannot be reached at the start is an error, as nothing is lost then. What a tracker missed, by its own failure or
since the run was killed, it is told when the run goes on, or by the same command again once the run has finished.
"""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from pinn_cli.runs.tracking_state import FILE, NONE, TrackingState
from pinn_cli.settings.errors import InputError
from pinn_cli.tracking.base import FAILED, FINISHED, INTERRUPTED, TrackedRun, Tracker, Tracking
from pinn_cli.tracking.outcome import Outcome, history

log = logging.getLogger(__name__)

# Seconds from one batch of rows to the next: a database is not to be written to at each iteration.
EVERY_S = 5.0
# To one that has failed nothing is told for twice as long as before, up to so long: each try may take a while.
MOST_S = 320.0


class Followed:
    """One tracked run.

    Args:
        tracker: None where nothing is tracked.
        directory: Of the run.
        state: Which tracked run it is, and how far.
        clock: In seconds.
    """

    def __init__(
        self,
        tracker: Tracker | None,
        directory: Path,
        state: TrackingState,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.tracker, self.directory, self.state, self.clock = tracker, directory, state, clock
        self._waiting: list[dict[str, float]] = []
        self._flushed, self._every_s = clock(), EVERY_S
        self._complained = False
        self._complete = False

    def row(self, row: Mapping[str, float]) -> None:
        """Note a row of the history; one that the tracker had before an interruption is passed over."""
        last = self._waiting[-1]["iteration"] if self._waiting else self.state.logged
        if self.tracker is None or row["iteration"] <= last:
            return
        self._waiting.append(dict(row))
        if self.clock() - self._flushed >= self._every_s:
            self.flush()

    def flush(self) -> None:
        """Hand over the rows that wait; they wait on if the tracker fails."""
        rows = self._waiting
        if rows:
            handed = self._tried(lambda tracker: tracker.rows(rows))
            self._every_s = EVERY_S if handed else min(2.0 * self._every_s, MOST_S)
            if handed:
                self._waiting = []
                self._keep(logged=rows[-1]["iteration"])
        self._flushed = self.clock()

    def results(self) -> None:
        """Hand over what the run has left in its directory, and the rows that the tracker missed."""
        if self.tracker is None:
            return
        for row in history(self.directory):
            self.row(row)
        self.flush()
        handed = self._tried(lambda tracker: tracker.results(Outcome.read(self.directory)))
        self._complete = handed and not self._waiting

    def end(self, status: str, reason: str = "") -> None:
        """Say how it ended."""
        self.flush()
        ended = self._tried(lambda tracker: tracker.end(status, reason))
        if ended and self._complete and status == FINISHED:
            self._keep(ended=True)

    def delete(self) -> None:
        """Leave no trace of it."""
        self._tried(lambda tracker: tracker.delete())
        if self.tracker is not None:
            (self.directory / FILE).unlink(missing_ok=True)

    def _keep(self, **changes: float | bool) -> None:
        self.state = replace(self.state, **changes)  # type: ignore[arg-type]
        self.state.write(self.directory)

    def _tried(self, call: Callable[[Tracker], None]) -> bool:
        if self.tracker is None:
            return False
        try:
            call(self.tracker)
        except Exception as error:
            if not self._complained:
                log.warning("tracking=%s: %s; the run goes on", self.state.tracking, str(error).partition("\n")[0])
            self._complained = True
            return False
        return True


@contextmanager
def follow(tracking: Tracking, run: TrackedRun, resuming: bool) -> Iterator[Followed]:
    """Track what happens in the block, and how it ends.

    Args:
        tracking: Where.
        run: The run.
        resuming: Whether it may go on with the tracked run that its directory names, if that is of the same settings.

    Raises:
        InputError: The tracker cannot be reached.
    """
    before = TrackingState.read(run.directory)
    before = before if before is not None and before.tracking == tracking.name else None
    known = resuming and before is not None and before.configuration == run.configuration
    followed = _opened(tracking, run, before if known else None)
    if before is not None and not known:
        with suppress(Exception):
            tracking.abandon(before.key)
    try:
        yield followed
    except InputError as error:
        if known:
            followed.end(FAILED, str(error).partition("\n")[0])
        else:
            followed.delete()
        raise
    except Exception as error:
        followed.end(FAILED, str(error).partition("\n")[0] or type(error).__name__)
        raise
    except BaseException as stop:
        followed.end(INTERRUPTED, str(stop) or type(stop).__name__)
        raise
    followed.end(FINISHED)


def _opened(tracking: Tracking, run: TrackedRun, before: TrackingState | None) -> Followed:
    """The tracked run that the directory names, or a new one, whose key is written down before it is made."""
    new = TrackingState(tracking.name, run.configuration, uuid.uuid4().hex)
    state = new if before is None else replace(before, ended=False)
    file = run.directory / FILE
    content = file.read_bytes() if file.is_file() else None
    if tracking.name != NONE:
        state.write(run.directory)
    try:
        tracker = tracking.open(run, state, before is not None)
    except InputError:
        if content is not None:
            file.write_bytes(content)
        elif tracking.name != NONE:
            file.unlink(missing_ok=True)
        raise
    if tracker is not None and tracker.logged is not None:
        state = replace(state, logged=tracker.logged)
    return Followed(tracker, run.directory, state)
