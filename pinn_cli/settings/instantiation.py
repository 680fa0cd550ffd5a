"""Building an object from a node of the configuration: of the class that it names (`_target_`), or the caller does.

A configuration may come from somebody else, so it may choose among this package's and torch's classes but run nothing:
a target is refused unless it is a class *defined* under one of those two packages. Looking at the name alone would not
do: `pinn_cli.any_module.os.system` begins well.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
from collections.abc import Callable
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.suggestion import suggestion

PACKAGES = ("pinn_cli", "torch")


def check_classes(node: object, setting: str = "") -> None:
    """Refuse a configuration with a target outside this package and torch, before anything of it is built.

    Args:
        node: A node of the composed configuration, searched to its leaves.
        setting: The node's own name, for the message.

    Raises:
        InputError: At the first `_target_` that is refused.
    """
    if isinstance(node, DictConfig) and not node._is_none():
        if "_target_" in node:
            _check_name(f"{setting}._target_", node["_target_"])
        for key in node:
            check_classes(node._get_node(key), f"{setting}.{key!s}" if setting else str(key))
    elif isinstance(node, ListConfig) and not node._is_none():
        for index in range(len(node)):
            check_classes(node._get_node(index), f"{setting}[{index}]")


def build(node: DictConfig, setting: str, /, **arguments: Any) -> Any:
    """The object that a node describes: its class called with the node's other entries, nested nodes built first.

    Args:
        node: A node with a `_target_`; lists and mappings reach the class as plain `list` and `dict`.
        setting: The node's name as a user types it (`excitation`); errors name it.
        **arguments: Further arguments for the class, not from the configuration; what it does not take is left out.

    Raises:
        InputError: The target is none of ours, an entry is unknown or missing, or the class itself refuses a value.
    """
    check_classes(node, setting)
    target = node.get("_target_")
    if target is None:
        raise InputError(f"{setting}._target_", "(missing)", "the class that the node describes")
    return construct(_located(f"{setting}._target_", target), node, setting, **arguments)


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


def _check_name(setting: str, target: object) -> None:
    if not isinstance(target, str) or target.split(".")[0] not in PACKAGES or "." not in target:
        hint = "a configuration may choose classes but not run other code"
        raise InputError(setting, target, "a class of pinn_cli or torch", hint)


def _located(setting: str, target: str) -> type:
    """The class of that dotted name; its module must be a real module of one of `PACKAGES` and define it."""
    module_name, _, name = target.rpartition(".")
    try:
        found = importlib.util.find_spec(module_name)
    except ModuleNotFoundError:
        found = None
    if found is None:
        raise InputError(setting, target, "an existing class", suggestion(module_name, _modules_beside(module_name)))
    module = importlib.import_module(module_name)
    cls = getattr(module, name, None)
    if cls is None:
        classes = [n for n, member in inspect.getmembers(module, inspect.isclass) if member.__module__ == module_name]
        raise InputError(setting, target, f"a class of {module_name}", suggestion(name, classes))
    if not inspect.isclass(cls) or cls.__module__.split(".")[0] not in PACKAGES:
        raise InputError(setting, target, "a class defined in pinn_cli or torch", f"this is a {type(cls).__name__}")
    return cls


def _modules_beside(module_name: str) -> list[str]:
    package, _, _ = module_name.rpartition(".")
    try:
        folder = importlib.import_module(package)
    except ImportError:
        return []
    return [f"{package}.{module.name}" for module in pkgutil.iter_modules(getattr(folder, "__path__", []))]
