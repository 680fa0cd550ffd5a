"""No tracking."""

from __future__ import annotations

from pinn_cli.runs.resume import NONE
from pinn_cli.tracking.base import TrackedRun, Tracking


class NoTracking(Tracking):
    """The run's own files alone."""

    name = NONE

    def open(self, run: TrackedRun, key: str, before: str) -> None:
        """Nothing to open."""
