"""What the `hydra` node of a configuration may say, checked before Hydra acts on it.

Hydra builds its callbacks, handlers of logs, launchers and sweepers from that node, and a configuration may come from
somebody else. So each has to be one of ours or of an installed package (`pinn_cli.settings.registry`), a log goes into
the run's own directory, and what a scheduler passes to a shell is typed by the user. Values are looked at as they are
written: one that is put together by `${...}` might be another one by the time that Hydra reads it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf, open_dict

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import check_classes
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.settings.registry import CALLBACKS, check_registered

# Of the libraries: they choose how a run is computed, and name no file.
ENVIRONMENT = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
    "CUDA_VISIBLE_DEVICES",
)  # fmt: skip
# Words that a scheduler's options are made of; no space or line break, which could begin another option or command.
_WORD = re.compile(r"[\w.,:+=@%*-]*")
# Settings of a launcher that a file may set to any such word; each is an option of sbatch.
_WORDS = ("name", "partition", "account", "qos", "constraint", "exclude", "comment", "gres")


def _is_text(value: object) -> bool:
    # What begins with a protocol is looked up by Python, and what is interpolated by OmegaConf.
    return isinstance(value, str) and not re.match(r"\s*[a-z]+://", value) and "${" not in value


def _is_level(value: object) -> bool:
    return isinstance(value, int) or (isinstance(value, str) and re.fullmatch(r"[A-Z]+", value) is not None)


def _are_names(value: object) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _is_switch(value: object) -> bool:
    return isinstance(value, bool)


# What logs may be configured to do, `*` being any name. Python's `logging.config` calls whatever a configuration names:
# `()` of a handler, a `class`, and any value that begins with `ext://`.
_LOGGER = {"level": _is_level, "handlers": _are_names, "propagate": _is_switch}
_LOGGING: Mapping[tuple[str, ...], Callable[[Any], bool]] = {
    ("version",): (1,).__contains__,
    ("disable_existing_loggers",): _is_switch,
    ("formatters", "*", "format"): _is_text,
    ("formatters", "*", "datefmt"): _is_text,
    ("handlers", "*", "class"): ("logging.StreamHandler",).__contains__,
    ("handlers", "*", "formatter"): _is_text,
    ("handlers", "*", "level"): _is_level,
    ("handlers", "*", "stream"): ("ext://sys.stdout", "ext://sys.stderr").__contains__,
    **{("loggers", "*", name): allowed for name, allowed in _LOGGER.items()},
    **{("root", name): allowed for name, allowed in _LOGGER.items()},
}


def check_hydra(config: DictConfig, given: Sequence[str]) -> None:
    """Refuse a `hydra` node that would run code, write elsewhere, or reach other programs.

    Launchers and sweepers are marked such that Hydra builds them alone and no node within them.

    Args:
        config: As Hydra composed it, with its `hydra` node; changed in place by those marks.
        given: The overrides that it was composed under.

    Raises:
        InputError: At the first setting that is refused.
    """
    hydra: Any = OmegaConf.to_container(config.hydra, resolve=False)
    typed = [*hydra["overrides"]["hydra"], *hydra["overrides"]["task"]]
    if sorted(typed) != sorted(given):
        raise InputError("hydra.overrides", typed, "left out of files", "it is the command line that has overrides")
    for name in ("hydra_logging", "job_logging"):
        _check_logging(f"hydra.{name}", hydra[name])
    _check_callbacks(hydra["callbacks"])
    for name in ("launcher", "sweeper"):
        _check_plugin(name, hydra[name], typed)
    _check_environment(hydra["job"])
    _check_places(hydra)
    _check_verbose(hydra["verbose"])
    _build_alone(config.hydra)


def _check_logging(setting: str, node: object, kind: tuple[str, ...] = ()) -> None:
    """Refuse logs that call something or are written elsewhere than to the terminal.

    Args:
        setting: `hydra.job_logging` or `hydra.hydra_logging`, and what is within.
        node: Plain, as it is written.
        kind: Its place in `_LOGGING`.
    """
    if node is None or (kind in _LOGGING and _LOGGING[kind](node)):
        return
    if not isinstance(node, dict) or kind not in {known[: len(kind)] for known in _LOGGING if len(known) > len(kind)}:
        hint = "logs of these settings go to the terminal, and call nothing; a run writes its pinn-run.log itself"
        raise InputError(setting, node, "one of the settings of a logging.StreamHandler, written out", hint)
    for name, value in node.items():
        is_named = kind in (("formatters",), ("handlers",), ("loggers",))
        _check_logging(f"{setting}.{name}", value, (*kind, "*" if is_named else name))


def check_search_path(places: object) -> None:
    """Refuse folders of configurations that are Python packages, which are imported when they are searched.

    Args:
        places: What `hydra.searchpath` is given.

    Raises:
        InputError: One is no folder.
    """
    for place in places if isinstance(places, list) else [(places,)]:
        if not isinstance(place, str) or not re.match(r"(file|folder)://|(?!.*://)", place):
            raise InputError("hydra.searchpath", place, "a list of folders, file://FOLDER", "or --config-dir FOLDER")


def _check_callbacks(callbacks: object) -> None:
    if not isinstance(callbacks, dict):
        raise InputError(CALLBACKS, callbacks, "a mapping of names to callbacks")
    for name, callback in callbacks.items():
        setting = f"{CALLBACKS}.{name}"
        if not isinstance(callback, dict):
            raise InputError(setting, callback, "a mapping with the _target_ of a callback")
        check_registered(setting, callback.get("_target_"))
        _check_within(setting, callback)
        for path, value in _leaves(callback, setting):
            if isinstance(value, str) and "${" in value:
                raise InputError(path, value, "written out")


def _check_plugin(name: str, node: object, typed: Sequence[str]) -> None:
    """A launcher or a sweeper: its class, and that what may reach a shell or another machine is typed by the user."""
    setting = f"hydra.{name}"
    if not isinstance(node, dict):
        raise InputError(setting, node, "a group of settings")
    if node.get("_target_") != _built_in(name):
        check_registered(setting, node.get("_target_"))
    _check_within(setting, node)
    if name == "sweeper":
        return
    settings = {setting_of(override) for override in typed}
    for path, value in _leaves(node, setting):
        if not (_is_harmless(path, value) or any(f"{path}.".startswith(f"{given}.") for given in settings)):
            hint = "it reaches a shell, a file or another machine, and a file of somebody else's may not choose that"
            raise InputError(path, value, "given on the command line", hint)


def _check_within(setting: str, node: Mapping[str, Any]) -> None:
    """What stands in the node of a class of Hydra's besides its target."""
    if node.get("_recursive_", False) is not False:
        raise InputError(f"{setting}._recursive_", node["_recursive_"], "false")
    check_classes({key: value for key, value in node.items() if key != "_target_"}, setting)


def _is_harmless(path: str, value: object) -> bool:
    if not isinstance(value, str) or path.endswith("._target_") or (path, value) in _shipped_launchers():
        return True
    return path.rpartition(".")[2] in _WORDS and _WORD.fullmatch(value) is not None


@cache
def _shipped_launchers() -> frozenset[tuple[str, object]]:
    """Every setting of a launcher, with its value, in the program's own files and in installed plug-ins."""
    folder, store = Path(str(files("pinn_cli.conf") / "config.yaml")).parent, ConfigStore.instance()
    nodes = [OmegaConf.load(file) for file in folder.glob("hydra/launcher/*.yaml")]
    nodes += [store.load(f"hydra/launcher/{name}").node for name in store.list("hydra/launcher")]
    plain = (OmegaConf.to_container(node, resolve=False) for node in nodes)
    return frozenset(leaf for node in plain for leaf in _leaves(node, "hydra.launcher"))


@cache
def _built_in(name: str) -> str:
    """The target of Hydra's own launcher, or of the sweeper that `hydra_plugins` tells Hydra of."""
    node: Any = ConfigStore.instance().load(f"hydra/{name}/basic.yaml").node
    return str(node["_target_"])


def _leaves(node: object, setting: str) -> Iterator[tuple[str, Any]]:
    """Every value in nested mappings and lists, with the setting that it is of; the entries of a list share one."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            if isinstance(key, str) and _WORD.fullmatch(key) is None:
                raise InputError(f"{setting}.{key!r}", value, "named by letters, digits and any of . _ + -")
            yield from _leaves(value, f"{setting}.{key}")
    elif isinstance(node, Sequence) and not isinstance(node, str):
        for value in node:
            yield from _leaves(value, setting)
    else:
        yield setting, node


def _check_environment(job: Mapping[str, Any]) -> None:
    """`env_copy` is in `env_set` by now, with what this process has."""
    if not isinstance(job["env_set"], dict):
        raise InputError("hydra.job.env_set", job["env_set"], "a mapping of names to values")
    for name, value in job["env_set"].items():
        if name not in ENVIRONMENT and os.environ.get(name) != value:
            hint = "set it in the shell that starts pinn-run"
            raise InputError(f"hydra.job.env_set.{name}", value, f"one of the variables {', '.join(ENVIRONMENT)}", hint)


def _check_places(hydra: Mapping[str, Any]) -> None:
    """The name of the log, and the folder of what Hydra stores."""
    name, subdirectory = hydra["job"]["name"], hydra["output_subdir"]
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.+-]*", name):
        raise InputError("hydra.job.name", name, "a file's name: letters, digits, and any of . _ + -")
    if subdirectory is not None:
        raise InputError("hydra.output_subdir", subdirectory, "null", "a run writes .hydra/ itself, once it is checked")


def _check_verbose(verbose: object) -> None:
    for name in verbose if isinstance(verbose, list) and verbose else [verbose]:
        if not isinstance(name, bool) and not re.fullmatch(r"(pinn_cli|hydra)(\.\w+)*", str(name)):
            allowed = "true, false, or names of loggers, such as pinn_cli.training or hydra"
            raise InputError("hydra.verbose", verbose, allowed)


def _build_alone(hydra: DictConfig) -> None:
    for node in (hydra.launcher, hydra.sweeper):
        if not OmegaConf.is_missing(node, "_target_") and OmegaConf.get_type(node) is dict:
            with open_dict(node):
                node["_recursive_"] = False
