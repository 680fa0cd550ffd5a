"""Building an object from a node of the configuration, of a class that the node names (`_target_`).

A configuration may come from somebody else, so it may choose among registered classes but run nothing. Importing a
module runs it, so a target is compared with a list before anything is imported. The list is that of the files in
`conf/` that come with the program: what `conf/network/` names are the networks. A package that is installed beside it
adds its own by entry points of the group `pinn_cli.plugins`, which are read as text, too::

    [project.entry-points."pinn_cli.plugins"]
    "network.chebyshev" = "my_pinn.chebyshev:Chebyshev"

The name begins with the place, and what follows is free; the target is then `my_pinn.chebyshev.Chebyshev`.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.settings.errors import InputError, suggestion

PLUGINS = "pinn_cli.plugins"
CALLBACKS = "hydra.callbacks"
# The configurations that come with the program.
CONF = Path(str(files("pinn_cli.conf") / "config.yaml")).parent
_TARGET = re.compile(r"^ *_target_: *(\S+)", re.MULTILINE)


def place_of(setting: str) -> str:
    """The place that a setting belongs to, as a user types it: `system` of `system.connections[2].law`."""
    parts = re.split(r"[.\[]", setting)
    return ".".join(parts[:2]) if parts[0] == "hydra" else parts[0]


def registered(place: str) -> set[str]:
    """Dotted names of the classes that a place accepts."""
    declared = (point.value.replace(" ", "").replace(":", ".") for point in plugins_of(place).values())
    return {*shipped().get(place, ()), *declared}


def check_registered(setting: str, target: object) -> None:
    """Refuse a node's `_target_` that the place of its setting (`network`) does not accept; nothing is imported.

    Raises:
        InputError: It is none of the registered classes.
    """
    place = place_of(setting)
    if isinstance(target, str) and (target in shipped().get(place, ()) or target in registered(place)):
        return
    name = f"{setting}._target_" if setting else "_target_"
    names = sorted(registered(place))
    if not names and place != CALLBACKS:
        raise InputError(name, target, "left out", "no class belongs here: the settings are numbers and words")
    hint = suggestion(str(target), names) or (
        f"a configuration runs no other code; an installed package registers a class by the entry point"
        f" {place}.NAME of {PLUGINS} (docs/extending.md)"
    )
    allowed = f"a class that is registered for {place}: {', '.join(names) or 'there is none'}"
    raise InputError(name, target, allowed, hint)


@cache
def shipped() -> Mapping[str, frozenset[str]]:
    """The classes that the program itself brings, by place."""
    classes: dict[str, set[str]] = {}
    for file in (*CONF.glob("*/*.yaml"), *CONF.glob("hydra/*/*.yaml")):
        # A regular expression: to read all files as YAML would take longer than to start the program.
        targets = _TARGET.findall(file.read_text(encoding="utf-8"))
        classes.setdefault(".".join(file.parent.relative_to(CONF).parts), set()).update(targets)
    return {place: frozenset(targets) for place, targets in classes.items()}


def plugins_of(place: str) -> dict[str, EntryPoint]:
    """What installed packages declare for a place, by what follows it in the name; nothing is imported."""
    start = f"{place}."
    return {
        point.name.removeprefix(start): point
        for point in entry_points(group=PLUGINS)
        if place_of(point.name) == place and point.name.startswith(start)
    }


def check_classes(node: object, setting: str = "") -> None:
    """Refuse a configuration with a target that is not registered for its place, before anything of it is built.

    A node of the composed configuration, or plain mappings and lists, is searched to its leaves.

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
    module, _, name = target.rpartition(".")
    return construct(getattr(importlib.import_module(module), name), node, setting, **arguments)


def construct(make: Callable[..., Any], node: DictConfig, setting: str, /, **arguments: Any) -> Any:
    """`make` called with a node's entries, as `build` does; the node needs no `_target_`."""
    parameters = inspect.signature(make).parameters
    arguments = {name: value for name, value in arguments.items() if name in parameters}
    entries = {str(key): _entry(node[key], f"{setting}.{key!s}") for key in node if key != "_target_"}
    takes_any = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    names = [n for n, p in parameters.items() if n not in arguments and p.kind is not inspect.Parameter.VAR_KEYWORD]
    for key, value in entries.items():
        if key not in names and not takes_any:
            settings = ", ".join(f"{setting}.{name}" for name in names)
            raise InputError(f"{setting}.{key}", value, f"one of the settings {settings}", suggestion(key, names))
    for name in names:
        if parameters[name].default is inspect.Parameter.empty and name not in entries:
            raise InputError(f"{setting}.{name}", "(missing)", "given", f"the file that sets {setting} has to have it")
    return make(**entries, **arguments)


def _entry(value: Any, setting: str) -> Any:
    if isinstance(value, DictConfig) and "_target_" in value:
        return build(value, setting)
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
