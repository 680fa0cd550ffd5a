"""What Hydra tells of a sweep: where it lies, so that it can be shown and collected."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.sweep.jobs import Sweep
from pinn_cli.sweep.progress import Progress
from pinn_cli.sweep.refusal import Before

# The sweep that Hydra runs in this process, what its directory held before, and what shows how far it is.
_running: tuple[Sweep, Before, Progress] | None = None


class SweepCallback(Callback):
    """Hydra builds it at every start, so nothing slow is imported above."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note the sweep and show its progress."""
        global _running  # noqa: PLW0603
        with suppress(OmegaConfBaseException):  # where it is made of what only a job has, such as ${hydra.job.num}
            str(config.hydra.sweep.subdir)  # keeps the names of the swept settings for the jobs
        try:
            sweep = Sweep.of(config, Path(str(config.hydra.sweep.dir)))
        except OmegaConfBaseException:  # Hydra meets it next and reports it
            return
        progress = Progress(sweep)
        _running = sweep, Before.of(sweep), progress
        progress.start()


def ended_sweep() -> tuple[Sweep, Before] | None:
    """The sweep that ran, or was cut off, in this process, and what was there before; its progress is shown no more."""
    global _running  # noqa: PLW0603
    if _running is None:
        return None
    sweep, before, progress = _running
    _running = None
    progress.stop()
    return sweep, before
