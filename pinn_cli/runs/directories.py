"""The directories that Hydra makes before a run's input can be judged, and taking them away again.

Hydra creates a run's directory, its `.hydra/` and its log before the task sees the configuration. A run that its input
makes impossible must leave nothing behind, and must not touch what was there before it.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

# Hydra's own files, the composed configuration, the log, and a sweep's configuration; why a job of it failed, what a
# scheduler was to be given, and a search's trials.
_OF_HYDRA = {".hydra", "pinn-run.log", "multirun.yaml", "failure.json", ".submitit", "search.db"}

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
    missing = [p for p in (path, *path.parents) if not p.exists()]
    _fresh.extend(reversed(missing))


def discard(jobs: Iterable[Path]) -> None:
    """Remove what unusable input left: those jobs' directories and every new directory around them.

    Only a new directory goes, and only if it holds nothing but Hydra's files; results are never removed.
    """
    logging.shutdown()  # closes the log, which some systems need before its directory can go
    for directory in (*jobs, *reversed(_fresh)):
        new = any(path in _fresh for path in (directory, *directory.parents))
        if new and directory.is_dir() and {entry.name for entry in directory.iterdir()} <= _OF_HYDRA:
            shutil.rmtree(directory)
