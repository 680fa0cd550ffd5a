"""What a tracking is: somebody else's record of a run, which changes nothing of it; and a run under its eyes.

A tracker may fail, when its disk is full or its server is gone; the run goes on, and the log says so once. Only one
that cannot be reached at the start is an error, as nothing is lost then. What a tracker missed it is told by the same
command again, or when the run goes on.
"""

from __future__ import annotations

import importlib.util
import logging
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import pandas as pd

from pinn_cli.report.fitness import FORMULAS
from pinn_cli.runs.claim import LOCK
from pinn_cli.runs.reading import read_table
from pinn_cli.runs.resume import NONE, TrackingState, read_record
from pinn_cli.runs.resume import TRACKING as FILE
from pinn_cli.runs.writing import content_of, put_back
from pinn_cli.settings.errors import InputError

log = logging.getLogger(__name__)

# How a run may end.
FINISHED, FAILED, INTERRUPTED = "finished", "failed", "interrupted"
# Not copied: what only this program reads, and is large or gone when the run is, and what other trackers wrote.
NOT_COPIED = ("checkpoint.pt", "checkpoint.previous.pt", FILE, LOCK, "tensorboard", "chains")


@dataclass(frozen=True)
class TrackedRun:
    """The run that is tracked.

    Attributes:
        directory: Of the run.
        name: What a list of runs calls it.
        settings: Every setting by the name that a user types, as text.
        labels: What runs are told apart by: case, scheme, number of DOFs, ...
        configuration: Digest of the settings that its numbers depend on.
    """

    directory: Path
    name: str
    settings: Mapping[str, str]
    labels: Mapping[str, object]
    configuration: str


@dataclass(frozen=True)
class Outcome:
    """What came of a run that has ended, read from the files that it left.

    Attributes:
        metrics: Name to value, finite: ``fitness_percent/displacement``, ``error_percent/k_2``, ``seconds/total``, ...
            A baseline's begin with its name.
        figures: As PNG.
        files: Files and folders to keep.
    """

    metrics: dict[str, float]
    figures: list[Path]
    files: list[Path]

    @classmethod
    def read(cls, directory: Path) -> Outcome:
        """Of the run in a directory."""
        fitness = read_table(directory / "fitness.csv", FORMULAS, ("estimator", "group", "quantity"))
        errors = read_table(directory / "parameters.csv", ("error_percent",), ("estimator", "parameter"))
        record = read_record(directory)
        numbers = {n: v for n, v in record.get("training", {}).items() if isinstance(v, int | float)}
        values: dict[str, float | None] = {"validation_score": record.get("validation", {}).get("score")}
        values |= {f"seconds/{name}": value for name, value in record.get("seconds", {}).items()}
        values |= {f"training/{name}": value for name, value in numbers.items() if not isinstance(value, bool)}
        for table, of, columns in (
            (fitness[fitness["group"] == "all"], "quantity", FORMULAS),
            (errors, "parameter", ("error_percent",)),
        ):
            for _, row in table.iterrows():
                whose = "" if row["estimator"] == "pinn" else f"{row['estimator']}/"
                values |= {f"{whose}{column}/{row[of]}": row[column] for column in columns}
        metrics = {name: float(value) for name, value in values.items() if pd.notna(value)}
        files = [entry for entry in sorted(directory.iterdir()) if entry.name not in NOT_COPIED]
        return cls(metrics, sorted((directory / "figures").glob("*.png")), files)


class Tracker(ABC):
    """One run as a tracker sees it. Each process that makes a part of a run tells all its rows, from the first on."""

    @abstractmethod
    def row(self, row: Mapping[str, float]) -> None:
        """Note a row of the history: ``iteration``, ``seconds``, ``loss_*``, ``weight_*``."""

    @abstractmethod
    def end(self, status: str, reason: str, outcome: Outcome | None) -> None:
        """Note how it ended, `FINISHED`, `FAILED` or `INTERRUPTED`, why, and what came of it; nothing follows."""

    def delete(self) -> None:  # noqa: B027
        """Take away what was noted so far, if anything was: the input was no use."""


class Tracking(ABC):
    """Where runs are tracked. A new one is a file here and a file in ``conf/tracking``.

    Attributes:
        name: The name of the config group's choice, and of the module.
    """

    name: ClassVar[str]

    @abstractmethod
    def open(self, run: TrackedRun, key: str, before: str) -> Tracker:
        """Begin to track a run.

        Args:
            run: The run.
            key: Which tracked run it is, letters and digits.
            before: The key of the one that the run's directory had before: the same where this run goes on with it,
                another one where it takes its place, empty where there was none.

        Raises:
            InputError: The tracker cannot be reached, or would have to change what is not its own.
        """


def require(package: str, choice: str) -> None:
    """Refuse a choice of the group whose package is not installed."""
    if importlib.util.find_spec(package) is None:
        allowed = "none, or a choice whose packages are installed"
        raise InputError("tracking", choice, allowed, f"pip install 'pinn-cli[{choice}]'")


class Followed:
    """One tracked run, which its state names; the tracker is None where nothing is tracked."""

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
            for row in read_table(self.directory / "history.csv").to_dict("records"):
                self.row({str(name): float(value) for name, value in row.items() if pd.notna(value)})
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
def follow(tracking: Tracking | None, run: TrackedRun, resuming: bool) -> Iterator[Followed]:
    """Track what happens in the block, and how it ends; nothing where there is no tracking.

    When ``resuming`` it may go on with the tracked run that its directory names, if that is of the same settings.

    Raises:
        InputError: The tracker cannot be reached.
    """
    if tracking is None:
        yield Followed(None, run.directory, TrackingState(NONE, run.configuration, ""))
        return
    before = TrackingState.read(run.directory)
    before = before if before is not None and before.tracking == tracking.name else None
    goes_on = resuming and before is not None and before.configuration == run.configuration
    key_before = "" if before is None else before.key
    state = TrackingState(tracking.name, run.configuration, key_before if goes_on else uuid.uuid4().hex)
    # Written down before the tracker hears of it, so that a kill leaves nothing that nobody finds again.
    content = content_of(run.directory / FILE)
    state.write(run.directory)
    try:
        followed = Followed(tracking.open(run, state.key, key_before), run.directory, state)
    except InputError:
        put_back(run.directory / FILE, content)
        raise
    try:
        yield followed
    except BaseException as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        if isinstance(error, InputError) and not goes_on:
            followed.delete()
        else:
            followed.end(FAILED if isinstance(error, Exception) else INTERRUPTED, reason)
        raise
    followed.end(FINISHED)
