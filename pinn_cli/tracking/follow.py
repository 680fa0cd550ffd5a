"""A run under the eyes of a tracker: its rows as they come, what came of it, and how it ended.

A tracker may fail, when its disk is full or its server is gone; the run goes on, and the log says so once. Only one
that cannot be reached at the start is an error, as nothing is lost then. What a tracker missed it is told by the same
command again, or when the run goes on.
"""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from pinn_cli.runs.resume import NONE, TrackingState
from pinn_cli.runs.resume import TRACKING as FILE
from pinn_cli.runs.writing import content_of, put_back
from pinn_cli.settings.errors import InputError
from pinn_cli.tracking.base import FAILED, FINISHED, INTERRUPTED, TrackedRun, Tracker, Tracking
from pinn_cli.tracking.outcome import Outcome, history

log = logging.getLogger(__name__)


class Followed:
    """One tracked run.

    Args:
        tracker: None where nothing is tracked.
        directory: Of the run.
        state: Which tracked run it is.
    """

    def __init__(self, tracker: Tracker | None, directory: Path, state: TrackingState) -> None:
        self.tracker, self.directory, self.state = tracker, directory, state
        self._outcome: Outcome | None = None
        self._last = float("-inf")

    def row(self, row: Mapping[str, float]) -> None:
        """Note a row of the history, once."""
        if row["iteration"] > self._last:
            self._last = row["iteration"]
            self._tell(lambda tracker: tracker.row(row))

    def results(self) -> None:
        """Note what the run has left in its directory, with the rows that no training in this process went through."""
        if self.tracker is not None:
            for row in history(self.directory):
                self.row(row)
            self._outcome = Outcome.read(self.directory)

    def end(self, status: str, reason: str = "") -> None:
        """Say how it ended."""
        self._tell(lambda tracker: tracker.end(status, reason, self._outcome))
        if self.tracker is not None and status == FINISHED and self._outcome is not None:
            replace(self.state, ended=True).write(self.directory)

    def delete(self) -> None:
        """Leave no trace of it."""
        if self.tracker is not None:
            self._tell(lambda tracker: tracker.delete())
            (self.directory / FILE).unlink(missing_ok=True)

    def _tell(self, call: Callable[[Tracker], None]) -> None:
        """One that has failed is told nothing more."""
        try:
            if self.tracker is not None:
                call(self.tracker)
        except Exception as error:
            self.tracker = None
            log.warning("tracking=%s: %s; the run goes on", self.state.tracking, str(error).partition("\n")[0])


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
    goes_on = resuming and before is not None and before.configuration == run.configuration
    key = before.key if goes_on and before is not None else uuid.uuid4().hex
    followed = _opened(tracking, run, key, "" if before is None else before.key)
    try:
        yield followed
    except InputError as error:
        if goes_on:
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


def _opened(tracking: Tracking, run: TrackedRun, key: str, before: str) -> Followed:
    """The key is written down before the tracker hears of it, so that a kill leaves nothing that nobody finds again."""
    state, file = TrackingState(tracking.name, run.configuration, key), run.directory / FILE
    if tracking.name == NONE:
        return Followed(None, run.directory, state)
    content = content_of(file)
    state.write(run.directory)
    try:
        return Followed(tracking.open(run, key, before), run.directory, state)
    except InputError:
        put_back(file, content)
        raise
