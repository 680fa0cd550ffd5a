"""No tracking."""

from __future__ import annotations

from pinn_cli.runs.tracked import NONE, Told
from pinn_cli.tracking.base import Job, Tracking


class NoTracking(Tracking):
    """The run's own files alone."""

    name = NONE

    def open(self, job: Job, told: Told, known: bool) -> None:
        """Nothing to open."""
        return
