"""What `${...}` unfold to, counted before they are resolved: lines that each name the one before twice double it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pinn_cli.settings.errors import InputError

MOST_ENTRIES = 100_000
_REFERENCE = re.compile(r"\$\{(\.*)([\w.]+)\}")


def check_interpolations(node: Mapping[Any, Any]) -> None:
    """Refuse a configuration whose interpolations unfold to more than `MOST_ENTRIES`.

    Args:
        node: Plain, as it is written.

    Raises:
        InputError: Naming the first setting that does, or that names itself.
    """
    sizes: dict[tuple[Any, ...], int | None] = {}

    def size(path: tuple[Any, ...], value: Any) -> int:
        if sizes.get(path, 0) is None:
            raise InputError(".".join(map(str, path)), value, "resolvable", "it names itself")
        if path not in sizes:
            sizes[path] = None  # while it is counted
            if isinstance(value, Mapping):
                parts = [((*path, key), part) for key, part in value.items()]
            elif isinstance(value, list):
                parts = [((*path, index), part) for index, part in enumerate(value)]
            else:
                named = _REFERENCE.findall(value) if isinstance(value, str) else []
                places = [_place(path, dots, name) for dots, name in named]
                parts = [(place, _at(node, place)) for place in places]
            entries = 1 + sum(size(place, part) for place, part in parts)
            if entries > MOST_ENTRIES:
                hint = f"its interpolations unfold to {entries:.3g}"
                raise InputError(".".join(map(str, path)), "${...}", f"at most {MOST_ENTRIES} values", hint)
            sizes[path] = entries
        return sizes[path] or 0

    size((), node)


def _place(path: tuple[Any, ...], dots: str, name: str) -> tuple[Any, ...]:
    """What is named there: from the root, or with a dot from the mapping around it."""
    around = path[: -len(dots)] if dots else ()
    return (*around, *name.split("."))


def _at(node: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        node = node.get(key) if isinstance(node, Mapping) else None
    return node
