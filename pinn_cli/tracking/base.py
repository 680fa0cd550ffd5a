"""What a tracking is: somebody else's record of a run, which changes nothing of it."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

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
        name: The name of the config group's choice.
    """

    name: ClassVar[str]

    @abstractmethod
    def open(self, run: TrackedRun, key: str, before: str) -> Tracker | None:
        """Begin to track a run; None where nothing is tracked.

        Args:
            run: The run.
            key: Which tracked run it is, letters and digits.
            before: The key of the one that the run's directory had before: the same where this run goes on with it,
                another one where it takes its place, empty where there was none.

        Raises:
            InputError: The tracker cannot be reached, or would have to change what is not its own.
        """


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
