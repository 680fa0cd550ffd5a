"""What `${...}` unfold to, counted before they are resolved: lines that each name the one before twice double it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from pinn_cli.settings.errors import InputError

# Values, and hundreds of characters.
MOST_ENTRIES, CHARACTERS = 100_000, 100
_INNERMOST = re.compile(r"\$\{([^${}]*)\}")
_WITHIN = "\0"  # in the place of an interpolation that stands within another
# Of OmegaConf's resolvers those whose arguments are no names of settings.
_NAME_NOTHING = ("oc.env", "now")

_Path = tuple[Any, ...]


def check_interpolations(node: Mapping[Any, Any], ours: str = "") -> None:
    """Refuse a configuration whose interpolations unfold to more than `MOST_ENTRIES`, or hide what they name.

    Args:
        node: Plain, as it is written.
        ours: Text of the program's own configuration, whose values are known to be harmless.

    Raises:
        InputError: Naming the first setting that does, or that names itself.
    """
    sizes: dict[_Path, int | None] = {}

    def size(path: _Path, value: Any) -> int:
        if sizes.get(path, 0) is None:
            raise InputError(".".join(map(str, path)), value, "resolvable", "it names itself")
        if path not in sizes:
            sizes[path] = None  # while it is counted
            own, parts = 1, []
            if isinstance(value, Mapping):
                parts = [((*path, key), part) for key, part in value.items()]
            elif isinstance(value, list):
                parts = [((*path, index), part) for index, part in enumerate(value)]
            elif isinstance(value, str):
                own += len(value) // CHARACTERS
                parts = [] if f" {value}\n" in ours else [_at(node, place) for place in _named(path, value)]
            entries = own + sum(size(place, part) for place, part in parts)
            if entries > MOST_ENTRIES:
                hint = f"its interpolations unfold to {entries:.3g}"
                raise InputError(".".join(map(str, path)), "${...}", f"at most {MOST_ENTRIES} values", hint)
            sizes[path] = entries
        return sizes[path] or 0

    size((), node)


def _named(path: _Path, value: str) -> Iterator[_Path]:
    """Places of the settings that a text names: from the root, or with a dot from the mapping around it."""
    hidden = InputError(".".join(map(str, path)), value, "written with interpolations that name a setting plainly")
    while found := _INNERMOST.search(value):
        resolver, colon, arguments = found[1].partition(":")
        names = [found[1]] if not colon else [] if resolver in _NAME_NOTHING else arguments.split(",")
        for name in map(str.strip, names):
            if re.search(r"[\\'\"]", name) or (_WITHIN in name and (not colon or resolver.startswith("oc."))):
                raise hidden
            dots = len(name) - len(name.lstrip("."))
            around = path[:-dots] if dots else ()
            yield (*around, *re.findall(r"[^.\[\]]+", name))
        value = value[: found.start()] + _WITHIN + value[found.end() :]
    if "${" in value:
        raise hidden


def _at(node: Any, place: _Path) -> tuple[_Path, Any]:
    """What lies there, under its own place; a text on the way, which may stand for what holds it."""
    path: _Path = ()
    for name in place:
        if isinstance(node, Mapping):
            key: Any = next((key for key in node if str(key) == str(name)), None)
            node = node.get(key)
        elif isinstance(node, list) and str(name).lstrip("-").isdecimal() and -len(node) <= int(name) < len(node):
            key = int(name) % len(node)
            node = node[key]
        else:
            break
        path = (*path, key)
    return path, node
