"""Texts that Hydra and OmegaConf read: overrides of the command line, and what `${...}` in values unfold to."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pinn_cli.settings.errors import InputError

# Values, and hundreds of characters: lines that each name the one before twice double it.
MOST_ENTRIES, CHARACTERS = 100_000, 100
_INTERPOLATION = re.compile(r"\$\{([^${}]*)\}")
# Words that are read as they are written; the others would be numbers or Booleans, to Hydra or to YAML.
_PLAIN = re.compile(r"(?!(?:true|false|null|nan|inf|on|off|yes|no)$)[a-z_][\w./-]*", re.ASCII | re.IGNORECASE)
# Of OmegaConf's resolvers those whose arguments are no names of settings.
_NAME_NOTHING = ("oc.env", "now")

_Path = tuple[Any, ...]


def quoted(value: str) -> str:
    """A value that Hydra's grammar takes as it stands, whatever characters a folder's name has."""
    # A backslash is itself but before a quotation mark, where it is written twice.
    escaped = re.sub(r"(\\*)('|$)", lambda match: match[1] * 2 + ("\\'" if match[2] else ""), value)
    return f"'{escaped}'"


def is_plain(value: str) -> bool:
    """Whether Hydra's grammar reads a text as itself without quotes."""
    return _PLAIN.fullmatch(value) is not None


def text_value(value: str) -> str:
    """A text as a value of an override; in double quotes where it needs some: a shell takes the single ones."""
    if is_plain(value):
        return value
    return quoted(value) if re.search(r'["\\]', value) else f'"{value}"'


def with_folder_quoted(override: str) -> str:
    """``model=sweeps/a=1,b=2`` as Hydra reads it; of a sweep's job the folder's name has signs of Hydra's grammar."""
    name, _, value = override.partition("=")
    plain = name != "model" or not re.search(r"[=,]", value) or not Path(value).expanduser().is_dir()
    return override if plain else f"{name}={quoted(value)}"


def setting_of(override: str) -> str:
    """The setting that an override is about, whatever it does with it: `seed` of `seed=0`, `++seed=0` and `~seed`."""
    return override.partition("=")[0].lstrip("+~")


def check_interpolations(node: Mapping[Any, Any], ours: str = "") -> None:
    """Refuse a configuration whose interpolations unfold to more than `MOST_ENTRIES`, or hide what they name.

    They are counted before anything is resolved, in a plain node, as it is written. In ``ours``, the text of the
    program's own configuration, values are known to be harmless.

    Raises:
        InputError: Naming the first setting that does, or that names itself.
    """
    sizes: dict[_Path, int | None] = {}

    def size(path: _Path, value: Any) -> int:
        if sizes.get(path, 0) is None:
            raise InputError(".".join(map(str, path)), value, "resolvable", "it names itself")
        if path not in sizes:
            sizes[path] = None  # while it is counted
            count, parts = 1, []
            if isinstance(value, Mapping):
                parts = [((*path, key), part) for key, part in value.items()]
            elif isinstance(value, list):
                parts = [((*path, index), part) for index, part in enumerate(value)]
            elif isinstance(value, str):
                count += len(value) // CHARACTERS
                parts = [] if f" {value}\n" in ours else [_at(node, place) for place in _named(path, value)]
            entries = count + sum(size(place, part) for place, part in parts)
            if entries > MOST_ENTRIES:
                hint = f"its interpolations unfold to {entries:.3g}"
                raise InputError(".".join(map(str, path)), "${...}", f"at most {MOST_ENTRIES} values", hint)
            sizes[path] = entries
        return sizes[path] or 0

    size((), node)


def _named(path: _Path, value: str) -> Iterator[_Path]:
    """Places of the settings that a text names: from the root, or with a dot from the mapping around it."""
    hidden = "${" in _INTERPOLATION.sub("", value)
    for content in _INTERPOLATION.findall(value):
        resolver, colon, arguments = content.partition(":")
        names = [content] if not colon else [] if resolver in _NAME_NOTHING else arguments.split(",")
        for name in map(str.strip, names):
            hidden = hidden or re.search(r"[\\'\"]", name) is not None
            dots = len(name) - len(name.lstrip("."))
            yield (*(path[:-dots] if dots else ()), *re.findall(r"[^.\[\]]+", name))
    if hidden:
        raise InputError(".".join(map(str, path)), value, "written with interpolations that name a setting plainly")


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
