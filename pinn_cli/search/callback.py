"""What happens around a search: before it, the trials that are there are counted; after it, they are reported."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, open_dict, read_write

from pinn_cli.search.study import NAME, address, load, take_up
from pinn_cli.sweep.directories import swept_settings
from pinn_cli.sweep.jobs import SEARCHER, is_search


class Search(Callback):
    """Has a search go on where it was stopped. Hydra builds it at every start, so nothing slow is imported above."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the folder of the study, and leave the sweeper those of its trials that are missing."""
        if not is_search(config):
            return
        directory = Path(config.hydra.sweep.dir)
        directory.mkdir(parents=True, exist_ok=True)  # SQLite makes no folders
        # The sweeper warns of every failed trial, which the job itself has told; the storage tells what it is made of.
        logging.getLogger(SEARCHER).setLevel(logging.CRITICAL)
        logging.getLogger("alembic").setLevel(logging.WARNING)
        try:
            study = load(directory)
        except ImportError:  # of the sweeper's package: Hydra meets it next, and says what is missing
            return
        elsewhere = not str(config.hydra.launcher.get("_target_")).endswith("BasicLauncher")
        if elsewhere and config.hydra.sweeper.n_jobs == 1:
            print("one trial at a time: hydra.sweeper.n_jobs=2 has two at once", file=sys.stderr)
        with read_write(config), open_dict(config):
            _complete(config.hydra.sweeper, directory)
            _inform(config)
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


def _inform(config: DictConfig) -> None:
    """Tell our sampler what only the whole configuration knows."""
    sampler, params = config.hydra.sweeper.get("sampler"), config.hydra.sweeper.get("params") or {}
    if not str(sampler.get("_target_")).startswith("pinn_cli."):
        return
    searched = swept_settings(map(str, config.hydra.overrides.task), map(str, params))
    sampler.configured = {name: _configured(config, name) for name in searched}
    sampler.trials = config.hydra.sweeper.n_trials


def _configured(config: DictConfig, name: str) -> Any:
    """What a setting, or a config group, is without the search; None where that is no single value."""
    value = OmegaConf.select(config, name)
    if isinstance(value, DictConfig):
        return OmegaConf.select(config, "hydra.runtime.choices").get(name)
    return None if OmegaConf.is_config(value) else value
