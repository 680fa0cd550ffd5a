"""No tracking."""

from __future__ import annotations

from pinn_cli.tracking.base import Job, Tracking
from pinn_cli.tracking.told import NONE, Told


class NoTracking(Tracking):
    """The run's own files alone."""

    name = NONE

    def open(self, job: Job, told: Told, known: bool) -> None:
        """Nothing to open."""
        return
