"""Which classes a configuration may choose, place by place; known without importing any of them.

Importing a module runs it, so a target is compared with this list before anything is imported. The list is that of the
files in `conf/` that come with the program: what `conf/network/` names are the networks. A package that is installed
beside it adds its own by entry points of the group `pinn_cli.plugins`, which are read as text, too::

    [project.entry-points."pinn_cli.plugins"]
    "network.chebyshev" = "my_pinn.chebyshev:Chebyshev"

The name begins with the place, and what follows is free; the target is then `my_pinn.chebyshev.Chebyshev`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from pathlib import Path

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.suggestion import suggestion

PLUGINS = "pinn_cli.plugins"
CALLBACKS = "hydra.callbacks"
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
    """Refuse a target that its place does not accept; nothing is imported.

    Args:
        setting: Of the node that has the target: `network`.
        target: What stands there as `_target_`.

    Raises:
        InputError: It is none of the registered classes.
    """
    place = place_of(setting)
    if isinstance(target, str) and (target in shipped().get(place, ()) or target in registered(place)):
        return
    name = f"{setting}._target_" if setting else "_target_"
    known = sorted(registered(place))
    if not known and place != CALLBACKS:
        raise InputError(name, target, "left out", "no class belongs here: the settings are numbers and words")
    hint = suggestion(str(target), known) or (
        f"a configuration runs no other code; an installed package registers a class by the entry point"
        f" {place}.NAME of {PLUGINS} (docs/extending.md)"
    )
    raise InputError(
        name, target, f"a class that is registered for {place}: {', '.join(known) or 'there is none'}", hint
    )


@cache
def shipped() -> Mapping[str, frozenset[str]]:
    """The classes that the program itself brings, by place."""
    conf = Path(str(files("pinn_cli.conf") / "config.yaml")).parent
    found: dict[str, set[str]] = {}
    for file in (*conf.glob("*/*.yaml"), *conf.glob("hydra/*/*.yaml")):
        place = ".".join(file.parent.relative_to(conf).parts)
        for target in _targets(file):
            found.setdefault(place, set()).add(target)
    return {place: frozenset(targets) for place, targets in found.items()}


def _targets(file: Path) -> list[str]:
    # A regular expression: to read all files as YAML would take longer than to start the program.
    return _TARGET.findall(file.read_text(encoding="utf-8"))


def plugins_of(place: str) -> dict[str, EntryPoint]:
    """What installed packages declare for a place, by what follows it in the name; nothing is imported."""
    start = f"{place}."
    return {
        point.name.removeprefix(start): point
        for point in entry_points(group=PLUGINS)
        if place_of(point.name) == place and point.name.startswith(start)
    }
