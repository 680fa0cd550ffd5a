"""A configuration is composed by Hydra and checked; then it is shown, or a run or a sweep is started from it.

Neither Hydra nor a run acts on a configuration before it is checked.
"""

from __future__ import annotations

import re
import sys
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.core.utils import configure_log, run_job
from hydra.types import HydraContext, RunMode, TaskFunction
from omegaconf import DictConfig, OmegaConf, open_dict

from pinn_cli.runs.claim import note_new
from pinn_cli.runs.process import environment
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.hydra_node import check_hydra
from pinn_cli.settings.instantiation import CALLBACKS, CONF, build, check_classes, shipped
from pinn_cli.settings.override_syntax import check_interpolations, quoted, setting_of
from pinn_cli.settings.yaml_file import SCHEME
from pinn_cli.sweep.running import note_sweep

CONFIG, SEARCH_PATH = "config", "hydra.searchpath"
# The only group of which several options make sense, one over the other.
SEVERAL = "experiment"
# Settings that only a simulated record has, and what a measured one has instead.
OF_SIMULATIONS = {
    "noise": "a measured record brings its own noise",
    "simulation": "a measured record brings its own times",
    "excitation": "a measured record brings its own force",
    "scheme.unobserved": "data.holdout withholds sensors of a measured record",
    "scheme.unobserved_fraction": "data.holdout withholds sensors of a measured record",
    "scheme.sensors": "a measured record has the sensors that data.acceleration=... and the like name",
}


def _as_hydras(name: str) -> Any:
    return lambda loader, *args, **kwargs: getattr(loader.hydras, name)(*args, **kwargs)


class CheckedLoader(ConfigLoader):
    """Hydra's loader, whose configurations, those of a sweep's jobs too, are checked before they are handed out."""

    def __init__(self, hydras: ConfigLoader) -> None:
        self.hydras = hydras

    def load_configuration(
        self,
        config_name: str | None,
        overrides: list[str],
        run_mode: RunMode,
        from_shell: bool = True,
        validate_sweep_overrides: bool = True,
    ) -> DictConfig:
        """See :class:`hydra.core.config_loader.ConfigLoader`.

        Raises:
            InputError: A class is not registered, Hydra would do what `check_hydra` refuses, something is not used,
                or a file cannot be read.
        """
        for override in overrides:
            group, _, chosen = override.lstrip("+").partition("=")
            if group != SEVERAL and group.replace("/", ".") in shipped() and re.match(r"\s*\[", chosen):
                raise _several(group, chosen, chosen.strip(" []").replace(" ", ""))
        overrides = in_folders(overrides)
        given = config_name, overrides, run_mode, from_shell, validate_sweep_overrides
        return _checked(self.hydras.load_configuration(*given), overrides)

    def load_sweep_config(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        """See :class:`hydra.core.config_loader.ConfigLoader`; raises what `load_configuration` does."""
        of_hydra: Any = OmegaConf.to_container(master_config.hydra.overrides.hydra, resolve=False)
        sweep_overrides = in_folders(sweep_overrides)
        config = self.hydras.load_sweep_config(master_config, sweep_overrides)
        return _checked(config, [*of_hydra, *sweep_overrides])

    compute_defaults_list = _as_hydras("compute_defaults_list")
    get_group_options = _as_hydras("get_group_options")
    get_search_path = _as_hydras("get_search_path")
    get_sources = _as_hydras("get_sources")
    list_groups = _as_hydras("list_groups")


def _checked(config: DictConfig, overrides: Sequence[str]) -> DictConfig:
    check_hydra(config, overrides)
    _check_used(config, overrides)
    plain: Any = OmegaConf.to_container(config, resolve=False)
    of_hydra = plain.pop("hydra")
    ours = (CONF / f"{CONFIG}.yaml").read_text(encoding="utf-8")
    check_interpolations({**plain, "hydra": of_hydra}, ours)  # Hydra's last: it repeats what is typed
    check_classes(plain)
    return config


def _check_used(config: DictConfig, overrides: Sequence[str]) -> None:
    """Refuse what no run would use: several options where one is to be chosen, settings of a simulated record."""
    for group, chosen in config.hydra.runtime.choices.items():
        if OmegaConf.is_list(chosen) and group != SEVERAL:
            raise _several(group, str(chosen), ",".join(map(str, chosen)))
    kind = OmegaConf.select(config, "data.kind")
    if kind in (None, "simulated"):
        return
    for override in overrides:
        for name, instead in OF_SIMULATIONS.items():
            setting = setting_of(override)
            if f"{setting}.".startswith(f"{name}.") and not override.startswith("~"):
                raise InputError(setting, override.partition("=")[2], f"left out with data={kind}", instead)


def _several(group: str, chosen: str, options: str) -> InputError:
    """Hydra would lay the options over each other."""
    return InputError(group, chosen, "one option", f"pinn-run --multirun {group}={options} makes a run with each")


def in_folders(overrides: Sequence[str], config_dir: str | None = None) -> list[str]:
    """The same overrides, the folders that they have searched as `folder://`, `--config-dir` first.

    Hydra itself would read a file without a limit, and import a package.

    Raises:
        InputError: A folder is missing, or something else than folders is to be searched.
    """
    if config_dir is not None and not (config_dir and Path(config_dir).is_dir()):
        hint = "" if config_dir else "is a variable of the shell empty?"
        raise InputError("--config-dir", config_dir or "''", "an existing folder", hint)
    kept, places = [], [] if config_dir is None else [str(Path(config_dir).absolute())]
    for override in overrides:
        (parsed,) = OverridesParser.create().parse_overrides([override]) if "searchpath" in override else (None,)
        if parsed is None or parsed.key_or_group != SEARCH_PATH or parsed.is_delete():
            kept.append(override)
            continue
        value: Any = parsed.value()
        for place in value if isinstance(value, list) else [(value,)]:
            if not isinstance(place, str) or not re.match(r"(file|folder)://|(?!.*://)", place):
                raise InputError(SEARCH_PATH, place, "a list of folders, file://FOLDER", "or --config-dir FOLDER")
        places += value
    folders = (f"{SCHEME}://{re.sub('^(file|folder)://', '', place)}" for place in places)
    return [*kept, f"{SEARCH_PATH}=[{','.join(map(quoted, folders))}]"] if places else kept


@contextmanager
def checked_hydra() -> Iterator[CheckedLoader]:
    """Hydra with the configurations of this package, within the block."""
    with hydra.initialize_config_module("pinn_cli.conf", "pinn-run", version_base="1.3"):
        yield CheckedLoader(GlobalHydra.instance().config_loader())


def compose_config(overrides: Sequence[str], config_dir: str | None = None) -> DictConfig:
    """The configuration of ``pinn-run <overrides>``, without a process or a directory of its own.

    Raises:
        hydra.errors.HydraException: The overrides do not compose.
        InputError: They choose a class that is not registered.
    """
    with checked_hydra() as loader:
        config = loader.load_configuration(CONFIG, in_folders(overrides, config_dir), RunMode.RUN, from_shell=False)
    with open_dict(config):
        del config["hydra"]
    return config


def _as_typed(
    loader: CheckedLoader, overrides: Sequence[str], config_dir: str | None, multirun: bool = False
) -> DictConfig:
    """What a command line composes; a mapping that it gives, as `data.force={1: f1}`, may have keys of its own.

    Hydra wants a `++` for them. Whether a key is known is checked when the configuration is read.
    """
    mode = RunMode.MULTIRUN if multirun else RunMode.RUN
    typed = [re.sub(r"^(?=[\w.]+=\{)", "++", override) for override in in_folders(overrides, config_dir)]
    config = loader.load_configuration(CONFIG, [*typed, f"hydra.mode={mode.name}"] if multirun else typed, mode)
    if config.hydra.mode not in (None, mode):
        raise InputError("hydra.mode", config.hydra.mode.name, "left out", "pinn-run --multirun makes a sweep")
    config.hydra.mode = mode
    return config


class Callbacks:
    """Those that a configuration names, called in turn, the last first where something ends, as Hydra calls them.

    What one raises is a warning.
    """

    def __init__(self, nodes: DictConfig) -> None:
        self.callbacks = [build(node, f"{CALLBACKS}.{name!s}") for name, node in nodes.items()]

    def __getattr__(self, moment: str) -> Callable[..., None]:
        if not moment.startswith("on_"):
            raise AttributeError(moment)
        return partial(self._call, moment)

    def _call(self, moment: str, **given: Any) -> None:
        for callback in reversed(self.callbacks) if moment.endswith("_end") else self.callbacks:
            try:
                getattr(callback, moment)(**given)
            except Exception as error:
                warnings.warn(f"{type(callback).__name__}.{moment}: {error!r}", stacklevel=2)


def start(task: TaskFunction, overrides: Sequence[str], config_dir: str | None, multirun: bool) -> None:
    """Run one job, or all jobs of a sweep: call the task with its configuration, without its `hydra` node.

    Raises:
        Exception: Whatever Hydra says of overrides that do not compose, or the task raises.
    """
    with checked_hydra() as loader:
        config = _as_typed(loader, overrides, config_dir, multirun)
        configure_log(config.hydra.hydra_logging, config.hydra.verbose)
        callbacks: Any = Callbacks(config.hydra.callbacks)
        context, said = HydraContext(loader, callbacks), {"config": config, "config_name": CONFIG}
        if multirun:
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


def configuration_text(options: Namespace, overrides: Sequence[str], config_dir: str | None) -> str:
    """What `--cfg` prints, as YAML: settings of the job, of Hydra, or all; or a package of them.

    A configuration that would be refused if it were run, and a package that it has not, is refused.
    """
    with checked_hydra() as loader:
        config = _as_typed(loader, overrides, config_dir)
        HydraConfig.instance().set_config(config)  # which ${hydra:...} is resolved by
        OmegaConf.set_readonly(config.hydra, False)
        if options.resolve:
            OmegaConf.resolve(config)
        of_job = [name for name in config if name != "hydra"]
        parts = {"job": of_job, "hydra": ["hydra"], "all": [*of_job, "hydra"]}[options.cfg]
        if options.package in (None, "_global_"):
            return OmegaConf.to_yaml(OmegaConf.masked_copy(config, parts)).rstrip("\n")  # type: ignore[arg-type]
        chosen = OmegaConf.select(config, options.package)
        if chosen is None:
            hint = f"--cfg {options.cfg} prints all of it"
            raise InputError("--package", options.package, "a part of the configuration", hint)
        if not OmegaConf.is_config(chosen):
            return str(chosen)
        return f"# @package {options.package}\n{OmegaConf.to_yaml(chosen)}".rstrip("\n")


def show_by_hydra(option: str, overrides: Sequence[str] = ()) -> None:
    """Have Hydra print what `--hydra-help` or `--shell-completion` asks for: neither makes anything of the settings."""
    sys.argv[1:] = [option, *overrides]
    with environment({"HYDRA_FULL_ERROR": "1"}):  # so that Hydra raises, rather than prints and exits with status 1
        hydra.main(version_base="1.3", config_path="pkg://pinn_cli.conf", config_name=CONFIG)(lambda config: None)()
