"""Building an object from a node of the configuration: of the class that it names (`_target_`), or the caller does.

A configuration may come from somebody else, so it may choose among registered classes but run nothing: a target is
compared with `pinn_cli.settings.registry` before its module is imported.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.registry import check_registered
from pinn_cli.settings.suggestion import suggestion


def check_classes(node: object, setting: str = "") -> None:
    """Refuse a configuration with a target that is not registered for its place, before anything of it is built.

    Args:
        node: A node of the composed configuration, or plain mappings and lists, searched to its leaves.
        setting: The node's own name, for the message.

    Raises:
        InputError: At the first `_target_` that is refused; one that is an interpolation is.
    """
    plain = OmegaConf.to_container(node, resolve=False) if isinstance(node, DictConfig | ListConfig) else node
    if isinstance(plain, dict):
        if "_target_" in plain:
            check_registered(setting, plain["_target_"])
        for key, value in plain.items():
            check_classes(value, f"{setting}.{key!s}" if setting else str(key))
    elif isinstance(plain, list):
        for index, value in enumerate(plain):
            check_classes(value, f"{setting}[{index}]")


def build(node: DictConfig, setting: str, /, **arguments: Any) -> Any:
    """The object that a node describes: its class called with the node's other entries, nested nodes built first.

    Args:
        node: A node with a `_target_`; lists and mappings reach the class as plain `list` and `dict`.
        setting: The node's name as a user types it (`excitation`); errors name it.
        **arguments: Further arguments for the class, not from the configuration; what it does not take is left out.

    Raises:
        InputError: The target is not registered for its place, an entry is unknown or missing, or the class itself
            refuses a value.
    """
    check_classes(node, setting)
    target = node.get("_target_")
    if target is None:
        raise InputError(f"{setting}._target_", "(missing)", "the class that the node describes")
    return construct(_located(target), node, setting, **arguments)


def construct(make: Callable[..., Any], node: DictConfig, setting: str, /, **arguments: Any) -> Any:
    """`make` called with a node's entries, as `build` does; the node needs no `_target_`."""
    parameters = inspect.signature(make).parameters
    arguments = {name: value for name, value in arguments.items() if name in parameters}
    entries = {str(key): _entry(node[key], f"{setting}.{key!s}") for key in node if key != "_target_"}
    takes_any = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    known = [n for n, p in parameters.items() if n not in arguments and p.kind is not inspect.Parameter.VAR_KEYWORD]
    for key, value in entries.items():
        if key not in known and not takes_any:
            settings = ", ".join(f"{setting}.{name}" for name in known)
            raise InputError(f"{setting}.{key}", value, f"one of the settings {settings}", suggestion(key, known))
    for name in known:
        if parameters[name].default is inspect.Parameter.empty and name not in entries:
            raise InputError(f"{setting}.{name}", "(missing)", "given", f"the file that sets {setting} has to have it")
    return make(**entries, **arguments)


def _entry(value: Any, setting: str) -> Any:
    if isinstance(value, DictConfig) and "_target_" in value:
        return build(value, setting)
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value


def _located(target: str) -> Callable[..., Any]:
    """The class of a registered name."""
    module_name, _, name = target.rpartition(".")
    found: Callable[..., Any] = getattr(importlib.import_module(module_name), name)
    return found
