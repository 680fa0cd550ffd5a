"""What the `hydra` node of a configuration may say, checked before Hydra acts on it.

Hydra builds its callbacks, handlers of logs, launchers and sweepers from that node, and a configuration may come from
somebody else. So each has to be one of ours or of an installed package (`pinn_cli.settings.instantiation`), logs are
those of a shipped option, and what a scheduler passes to a shell is typed by the user. Values are looked at as they
are written: one that is put together by `${...}` might be another one by the time that Hydra reads it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf, open_dict

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import CALLBACKS, CONF, check_classes, check_registered
from pinn_cli.settings.override_syntax import setting_of

# Options of the two logs, which go to the terminal or nowhere: ours, and of Hydra's those that open no file.
LOGS = ("pinn_run", "silent", "none", "disabled", "stdout")
# Of the libraries: they choose how a run is computed, and name no file.
ENVIRONMENT = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
    "CUDA_VISIBLE_DEVICES",
)  # fmt: skip
# Words that a scheduler's options are made of; no space or line break, which could begin another option or command.
_WORD = re.compile(r"[\w.,:+=@%*-]*")
# Settings of a launcher that a file may set to any such word; each is an option of sbatch.
_WORDS = ("name", "partition", "account", "qos", "constraint", "exclude", "comment", "gres")


def check_hydra(config: DictConfig, given: Sequence[str]) -> None:
    """Refuse a `hydra` node that would run code, write elsewhere, or reach other programs.

    Args:
        config: As Hydra composed it, with its `hydra` node. Launchers and sweepers are marked in it such that Hydra
            builds them alone, and no node within them.
        given: The overrides that it was composed under.

    Raises:
        InputError: At the first setting that is refused.
    """
    hydra: Any = OmegaConf.to_container(config.hydra, resolve=False)
    typed = [*hydra["overrides"]["hydra"], *hydra["overrides"]["task"]]
    if sorted(typed) != sorted(given):
        raise InputError("hydra.overrides", typed, "left out of files", "it is the command line that has overrides")
    for name in ("hydra_logging", "job_logging"):
        chosen = hydra["runtime"]["choices"].get(f"hydra/{name}")
        if chosen not in LOGS or hydra[name] != _shipped_log(name, chosen):
            hint = "logs go to the terminal, and call nothing; a run writes its pinn-run.log itself"
            raise InputError(f"hydra.{name}", hydra[name], f"chosen by hydra/{name}={'|'.join(LOGS)} alone", hint)
    _check_callbacks(hydra["callbacks"])
    for name in ("launcher", "sweeper"):
        _check_plugin(name, hydra[name], typed)
        if OmegaConf.get_type(config.hydra[name]) is dict:
            with open_dict(config.hydra[name]):
                config.hydra[name]["_recursive_"] = False
    _check_job(hydra["job"])
    if hydra["output_subdir"] is not None:
        hint = "a run writes .hydra/ itself, once it is checked"
        raise InputError("hydra.output_subdir", hydra["output_subdir"], "null", hint)
    verbose = hydra["verbose"]
    for name in verbose if isinstance(verbose, list) and verbose else [verbose]:
        if not isinstance(name, bool) and not re.fullmatch(r"(pinn_cli|hydra)(\.\w+)*", str(name)):
            allowed = "true, false, or names of loggers, such as pinn_cli.training or hydra"
            raise InputError("hydra.verbose", verbose, allowed)


@cache
def _shipped_log(name: str, option: str) -> Any:
    shipped = CONF / "hydra" / name / f"{option}.yaml"
    file = shipped if shipped.is_file() else files("hydra.conf") / "hydra" / name / f"{option}.yaml"
    return OmegaConf.to_container(OmegaConf.create(file.read_text(encoding="utf-8"))) if file.is_file() else None


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
    store = ConfigStore.instance()
    if node.get("_target_") != store.load(f"{setting.replace('.', '/')}/basic.yaml").node["_target_"]:
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
    """What stands in the node of a class of Hydra's besides its target: no class that is not registered."""
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
    store = ConfigStore.instance()
    nodes = [OmegaConf.load(file) for file in CONF.glob("hydra/launcher/*.yaml")]
    nodes += [store.load(f"hydra/launcher/{name}").node for name in store.list("hydra/launcher")]
    plain = (OmegaConf.to_container(node, resolve=False) for node in nodes)
    return frozenset(leaf for node in plain for leaf in _leaves(node, "hydra.launcher"))


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


def _check_job(job: Mapping[str, Any]) -> None:
    """The name of its log, and its environment: `env_copy` is in `env_set` by now, with what this process has."""
    if not isinstance(job["name"], str) or not re.fullmatch(r"\w[\w.+-]*", job["name"]):
        raise InputError("hydra.job.name", job["name"], "a file's name: letters, digits, and any of . _ + -")
    if not isinstance(job["env_set"], dict):
        raise InputError("hydra.job.env_set", job["env_set"], "a mapping of names to values")
    for name, value in job["env_set"].items():
        if name not in ENVIRONMENT and os.environ.get(name) != value:
            hint = "set it in the shell that starts pinn-run"
            raise InputError(f"hydra.job.env_set.{name}", value, f"one of the variables {', '.join(ENVIRONMENT)}", hint)
