"""A run or a sweep is started from a configuration that was composed once and checked, through Hydra's interface."""

from __future__ import annotations

import sys
import warnings
from argparse import Namespace
from collections.abc import Sequence
from functools import partialmethod
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.core.utils import configure_log, run_job
from hydra.experimental.callback import Callback
from hydra.types import HydraContext, RunMode, TaskFunction
from omegaconf import DictConfig, OmegaConf, flag_override

from pinn_cli.cli.composing import CONFIG, CheckedLoader, as_hydra_reads, checked_hydra, in_folders
from pinn_cli.cli.terminal import Terminal
from pinn_cli.runs.claim import note_new
from pinn_cli.runs.process import environment
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build
from pinn_cli.settings.registry import CALLBACKS
from pinn_cli.sweep.callback import note_sweep


class Callbacks(Callback):
    """Those that a configuration names, called in turn, the last first where something ends, as Hydra calls them.

    What one raises is a warning.

    Args:
        nodes: Of the configuration.
    """

    def __init__(self, nodes: DictConfig) -> None:
        self.callbacks = [build(node, f"{CALLBACKS}.{name!s}") for name, node in nodes.items()]

    def _call(self, moment: str, **given: Any) -> None:
        for callback in reversed(self.callbacks) if moment.endswith("_end") else self.callbacks:
            try:
                getattr(callback, moment)(**given)
            except Exception as error:
                warnings.warn(f"{type(callback).__name__}.{moment}: {error!r}", stacklevel=2)

    on_run_start = partialmethod(_call, "on_run_start")
    on_run_end = partialmethod(_call, "on_run_end")
    on_multirun_start = partialmethod(_call, "on_multirun_start")
    on_multirun_end = partialmethod(_call, "on_multirun_end")
    on_job_start = partialmethod(_call, "on_job_start")
    on_job_end = partialmethod(_call, "on_job_end")


def start(task: TaskFunction, overrides: Sequence[str], config_dir: str | None, multirun: bool) -> None:
    """Run one job, or all jobs of a sweep.

    Args:
        task: Called with the composed configuration, without its `hydra` node.
        overrides: As typed.
        config_dir: A folder of more configurations.
        multirun: Whether a sweep is asked for on the command line; a file may do so, too.

    Raises:
        Exception: Whatever Hydra says of overrides that do not compose, or the task raises.
    """
    with checked_hydra() as loader:
        config = _composed(loader, [as_hydra_reads(o) for o in in_folders(overrides, config_dir)], multirun)
        configure_log(config.hydra.hydra_logging, config.hydra.verbose)
        callbacks: Any = Callbacks(config.hydra.callbacks)
        context, said = HydraContext(loader, callbacks), {"config": config, "config_name": CONFIG}
        if config.hydra.mode == RunMode.MULTIRUN:
            note_new(Path(str(config.hydra.sweep.dir)))
            note_sweep(config)
            callbacks.on_multirun_start(**said)
            sweeper = Plugins.instance().instantiate_sweeper(hydra_context=context, task_function=task, config=config)
            task_overrides: Any = OmegaConf.to_container(config.hydra.overrides.task, resolve=False)
            sweeper.sweep(arguments=task_overrides)
            callbacks.on_multirun_end(**said)
            return
        note_new(Path(str(config.hydra.run.dir)))
        callbacks.on_run_start(**said)
        done = run_job(task, config, "hydra.run.dir", None, context)
        callbacks.on_run_end(**said, job_return=done)
        _ = done.return_value  # raises what the job raised


def show(options: Namespace, overrides: Sequence[str], config_dir: str | None) -> None:
    """Print what `--cfg`, `--info`, `--hydra-help` or `--shell-completion` asks for; Hydra itself does but the first.

    Raises:
        InputError: The configuration is one that would be refused if it were run, or has no such package.
    """
    overrides = [as_hydra_reads(override) for override in in_folders(overrides, config_dir)]
    if options.hydra_help and overrides:
        raise InputError("--hydra-help", " ".join(overrides), "given alone")
    if options.cfg or options.info:
        with checked_hydra() as loader:
            config = _composed(loader, overrides, multirun=False)
            if options.cfg:
                Terminal().say(_configuration(config, options))
                return
    flags = ["--info", options.info] if options.info else []
    flags += [f"--{name.replace('_', '-')}" for name in ("resolve", "hydra_help", "shell_completion")
              if getattr(options, name)]  # fmt: skip
    sys.argv[1:] = [*flags, *overrides]
    with environment({"HYDRA_FULL_ERROR": "1"}):  # so that Hydra raises, rather than prints and exits with status 1
        hydra.main(version_base="1.3", config_path="pkg://pinn_cli.conf", config_name=CONFIG)(lambda config: None)()


def _configuration(config: DictConfig, options: Namespace) -> str:
    """What `--cfg` prints, as YAML: the job's settings, Hydra's, or all; a package of them, resolved or as written."""
    HydraConfig.instance().set_config(config)  # which ${hydra:...} is resolved by
    OmegaConf.set_readonly(config.hydra, False)
    left_out: dict[str, list[Any]] = {"job": ["hydra"], "hydra": [name for name in config if name != "hydra"]}
    with flag_override(config, "struct", False):
        for name in left_out.get(options.cfg, ()):
            del config[name]
    if options.cfg == "hydra":
        with flag_override(config.hydra, "struct", False):
            del config.hydra["help"], config.hydra["hydra_help"]
    package = None if options.package in (None, "_global_") else options.package
    chosen = config if package is None else OmegaConf.select(config, package)
    if chosen is None:
        raise InputError("--package", package, "a part of the configuration", f"--cfg {options.cfg} prints all of it")
    if not OmegaConf.is_config(chosen):
        return str(chosen)
    if options.resolve:
        OmegaConf.resolve(chosen)
    return ("" if package is None else f"# @package {package}\n") + OmegaConf.to_yaml(chosen).rstrip("\n")


def _composed(loader: CheckedLoader, overrides: list[str], multirun: bool) -> DictConfig:
    """The configuration of a run or of a sweep, whichever is asked for."""
    if multirun:
        overrides = [*overrides, f"hydra.mode={RunMode.MULTIRUN.name}"]
    swept = any(o.is_sweep_override() for o in OverridesParser.create().parse_overrides(overrides))
    mode = RunMode.MULTIRUN if multirun or swept else RunMode.RUN
    config = loader.load_configuration(CONFIG, overrides, mode)
    asked = config.hydra.mode or RunMode.RUN
    if asked != mode:  # Hydra says that values are swept without a sweep, or composes one that a file asks for
        config = loader.load_configuration(CONFIG, overrides, asked)
    config.hydra.mode = asked
    return config
