"""What happens around a search: before it, the trials that are there are counted; after it, they are reported."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, read_write

from pinn_cli.search.study import NAME, address, load, take_up

SWEEPER = "hydra_plugins.hydra_optuna_sweeper"


class Search(Callback):
    """Has a search go on where it was stopped. Hydra builds it at every start, so nothing slow is imported above."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the folder of the study, and leave the sweeper those of its trials that are missing."""
        if not is_search(config):
            return
        directory = Path(config.hydra.sweep.dir)
        directory.mkdir(parents=True, exist_ok=True)  # SQLite makes no folders
        # The sweeper warns of every failed trial, which the job itself has told; the storage tells what it is made of.
        logging.getLogger(SWEEPER).setLevel(logging.CRITICAL)
        logging.getLogger("alembic").setLevel(logging.WARNING)
        try:
            study = load(directory)
        except ImportError:  # of the sweeper's package: Hydra meets it next, and says what is missing
            return
        with read_write(config):
            _complete(config.hydra.sweeper, directory)
            if study is not None:
                config.hydra.sweeper.n_trials = max(0, config.hydra.sweeper.n_trials - take_up(study))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write the report and print it."""
        if is_search(config):
            logging.getLogger("fontTools").setLevel(logging.WARNING)
            from pinn_cli.search.report import report_search

            print(report_search(Path(config.hydra.sweep.dir)))


def _complete(sweeper: DictConfig, directory: Path) -> None:
    """What hydra/sweeper=optuna, the plugin's own preset, lacks to be kept and to survive a trial that fails."""
    if sweeper.storage is None:
        sweeper.storage, sweeper.study_name = address(directory), NAME
        sweeper.max_failure_rate = 1.0


def is_search(config: DictConfig) -> bool:
    """Whether Optuna is the sweeper."""
    return str(config.hydra.sweeper.get("_target_")).startswith(SWEEPER)
