"""The directories that Hydra makes before a run's input can be judged, and taking them away again.

Hydra makes a run's directory before the task sees the configuration. A command that its input makes impossible must
leave nothing behind, and must not touch what was there before it.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.runs.ownership import is_prepared

# Directories that did not exist before the run or sweep that Hydra started last, outermost first.
_fresh: list[Path] = []


class RunDirectories(Callback):
    """Notes, before Hydra makes them, which directories of a run or a sweep are new."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note the run's directory and its missing parents."""
        _note(config, "run")

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note the sweep's directory and its missing parents."""
        _note(config, "sweep")


def _note(config: DictConfig, mode: str) -> None:
    _fresh.clear()
    try:
        path = Path(str(config.hydra[mode].dir)).absolute()
    except OmegaConfBaseException:  # Hydra meets it next, makes no directory, and reports it
        return
    _fresh.extend(p for p in (path, *path.parents) if not os.path.lexists(p))


def discard() -> None:
    """Remove what unusable input left: directories that are new and in which no run was begun."""
    for directory in _fresh:
        if os.path.isdir(directory) and all(map(is_prepared, directory.iterdir())):
            shutil.rmtree(directory)
