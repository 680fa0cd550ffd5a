"""What a tracking is: somebody else's record of a run, which changes nothing of it."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from pinn_cli.runs.tracking_state import TrackingState
from pinn_cli.settings.errors import InputError
from pinn_cli.tracking.outcome import Outcome

# How a run may end.
FINISHED, FAILED, INTERRUPTED = "finished", "failed", "interrupted"


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


class Tracker(ABC):
    """One run as a tracker sees it.

    Attributes:
        logged: Iteration of the last row that it has, where it knows that better than the run's directory; or None.
    """

    logged: float | None = None

    @abstractmethod
    def rows(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Note rows of the history: ``iteration``, ``seconds``, ``loss_*``, ``weight_*``."""

    @abstractmethod
    def results(self, outcome: Outcome) -> None:
        """Note what came of it."""

    @abstractmethod
    def end(self, status: str, reason: str) -> None:
        """Note how it ended, `FINISHED`, `FAILED` or `INTERRUPTED`, and why; nothing follows."""

    @abstractmethod
    def delete(self) -> None:
        """Take it away: its input was no use."""


class Tracking(ABC):
    """Where runs are tracked. A new one is a file here and a file in ``conf/tracking``.

    Attributes:
        name: The name of the config group's choice.
    """

    name: ClassVar[str]

    @abstractmethod
    def open(self, run: TrackedRun, state: TrackingState, known: bool) -> Tracker | None:
        """Begin to track a run; None where nothing is tracked.

        Args:
            run: The run.
            state: Which tracked run it is, by its key, and how far.
            known: Whether there may be such a tracked run, to go on with: an earlier start may have been killed before
                it was made, or on the way.

        Raises:
            InputError: The tracker cannot be reached.
        """

    def abandon(self, key: str) -> None:  # noqa: B027
        """Note that a tracked run was cut off and that nothing goes on with it, where that is kept."""


def require(package: str, choice: str) -> None:
    """Refuse a choice of the group whose package is not installed.

    Raises:
        InputError: It is not.
    """
    try:
        found = importlib.util.find_spec(package) is not None
    except ModuleNotFoundError:
        found = False
    if not found:
        allowed = "none, or a choice whose packages are installed"
        raise InputError("tracking", choice, allowed, f"pip install 'pinn-cli[{choice}]'")
