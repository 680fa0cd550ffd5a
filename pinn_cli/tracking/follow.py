"""A run under the eyes of a tracker: its rows as they come, what came of it, and how it ended.

A tracker may fail, when its disk is full or its server is gone; the run goes on, and the log says so once. Only one
that cannot be reached at the start is an error, as nothing is lost then.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pinn_cli.errors import InputError
from pinn_cli.report.writing import write_json
from pinn_cli.tracking.base import FAILED, FINISHED, INTERRUPTED, Job, Tracker, Tracking
from pinn_cli.tracking.outcome import Outcome

log = logging.getLogger(__name__)

# In the run's directory: which tracked run it is, and how far.
FILE = "tracking.json"
# Seconds from one batch of rows to the next: a database is not to be written to at each iteration.
EVERY_S = 5.0
# Iteration of the last row where there is none; a history may begin at 0.
NOTHING = -1.0


class Followed:
    """One tracked run.

    Args:
        tracker: None where nothing is tracked.
        directory: Of the run.
        name: Of the tracking.
        logged: Iteration of the last row that the tracker has, when a run goes on.
        clock: In seconds.
    """

    def __init__(
        self,
        tracker: Tracker | None,
        directory: Path,
        name: str,
        logged: float = NOTHING,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.tracker, self.directory, self.name, self.logged, self.clock = tracker, directory, name, logged, clock
        self._waiting: list[dict[str, float]] = []
        self._flushed = clock()
        self._complained = False
        if tracker is not None:
            self._keep()

    def row(self, row: Mapping[str, float]) -> None:
        """Note a row of the history; one that the tracker had before an interruption is passed over."""
        if self.tracker is None or row["iteration"] <= self.logged:
            return
        self._waiting.append(dict(row))
        if self.clock() - self._flushed >= EVERY_S:
            self.flush()

    def flush(self) -> None:
        """Hand over the rows that wait."""
        rows, self._waiting, self._flushed = self._waiting, [], self.clock()
        if self.tracker is not None and rows and self._tried(lambda tracker: tracker.rows(rows)):
            self.logged = rows[-1]["iteration"]
            self._keep()

    def results(self) -> None:
        """Hand over what the run has left in its directory."""
        self.flush()
        self._tried(lambda tracker: tracker.results(Outcome.read(self.directory)))

    def end(self, status: str, reason: str = "") -> None:
        """Say how it ended."""
        self.flush()
        self._tried(lambda tracker: tracker.end(status, reason))

    def forget(self) -> None:
        """Leave no trace of it."""
        self._tried(lambda tracker: tracker.forget())
        (self.directory / FILE).unlink(missing_ok=True)

    def _keep(self) -> None:
        if self.tracker is not None:
            content = {"tracking": self.name, "key": self.tracker.key, "logged": self.logged}
            write_json(content, self.directory / FILE)

    def _tried(self, call: Callable[[Tracker], None]) -> bool:
        if self.tracker is None:
            return False
        try:
            call(self.tracker)
        except Exception as error:
            if not self._complained:
                log.warning("tracking=%s: %s; the run goes on", self.name, str(error).partition("\n")[0])
            self._complained = True
            return False
        return True


@contextmanager
def follow(tracking: Tracking, job: Job, resuming: bool) -> Iterator[Followed]:
    """Track what happens in the block, and how it ends.

    Args:
        tracking: Where.
        job: The run.
        resuming: Whether it may go on with the tracked run that its directory names.

    Raises:
        InputError: The tracker cannot be reached.
    """
    known = _known(job.directory, tracking.name) if resuming else {}
    tracker = tracking.open(job, known.get("key"))
    same = tracker is not None and tracker.key == known.get("key")
    followed = Followed(tracker, job.directory, tracking.name, float(known["logged"]) if same else NOTHING)
    try:
        yield followed
    except InputError:
        followed.forget()
        raise
    except Exception as error:
        followed.end(FAILED, str(error).partition("\n")[0] or type(error).__name__)
        raise
    except BaseException as stop:
        followed.end(INTERRUPTED, str(stop) or type(stop).__name__)
        raise
    followed.end(FINISHED)


def _known(directory: Path, name: str) -> dict[str, Any]:
    """The tracked run that a directory names; empty where there is none of this tracking."""
    try:
        content = json.loads((directory / FILE).read_text(encoding="utf-8"))
        found = {"key": str(content["key"]), "logged": float(content["logged"])}
        return found if content["tracking"] == name else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
