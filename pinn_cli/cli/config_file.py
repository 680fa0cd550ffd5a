"""`--config my.yaml`: the settings of one command in a file, as overrides before those that are typed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of, text_value
from pinn_cli.settings.yaml_file import read_yaml


def overrides_of(file: str, typed: Sequence[str]) -> list[str]:
    """What a file says, but for settings that are typed, too.

    ``system: linear`` chooses an option, ``system: {ndof: 3}`` and ``system.ndof: 3`` set one of its settings; a
    list of ``defaults``, as an experiment has it, chooses options.

    Raises:
        InputError: There is no such file, or it holds something else than settings.
    """
    path = Path(file)
    if not path.is_file():
        raise InputError(
            "--config", file or "''", "a file of settings (YAML) that exists", "--config-dir takes a folder"
        )
    plain: Any = OmegaConf.to_container(read_yaml(path), resolve=False)
    given = {setting_of(override) for override in typed}
    return [f"{name}={value}" for name, value in _settings(path, plain) if name not in given]


def _settings(path: Path, plain: Mapping[Any, Any]) -> Iterator[tuple[str, str]]:
    for name, value in plain.items():
        if name == "defaults":
            yield from _chosen(path, value)
        elif isinstance(value, Mapping) and "." not in str(name):
            yield from ((f"{name}.{part}", written(of_part)) for part, of_part in value.items())
        else:
            yield str(name), written(value)


def _chosen(path: Path, defaults: Any) -> Iterator[tuple[str, str]]:
    for entry in defaults if isinstance(defaults, list) else [defaults]:
        if entry == "_self_":
            continue
        if not isinstance(entry, Mapping) or len(entry) != 1:
            raise InputError(f"{path}, defaults", entry, "a list such as [{override /system: linear}, _self_]")
        ((group, option),) = entry.items()
        yield str(group).removeprefix("override").strip().lstrip("/"), written(option)


def written(value: Any) -> str:
    """A value as an override writes it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return text_value(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)}: {written(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(written, value)) + "]"
    return str(value)


def _key(key: Any) -> str:
    return re.sub(r"([\\()\[\]{}:=, \t])", r"\\\1", str(key))
