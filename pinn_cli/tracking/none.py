"""No tracking."""

from __future__ import annotations

from pinn_cli.tracking.base import Job, Tracking


class NoTracking(Tracking):
    """The run's own files alone."""

    name = "none"

    def open(self, job: Job, known: str | None) -> None:
        """Nothing to open."""
        return
