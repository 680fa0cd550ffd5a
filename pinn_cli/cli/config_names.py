"""What there is to choose from: names of options and settings, read from the config files when an error lists them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException


def option_names(group: str, config_dir: str | None = None) -> Iterator[str]:
    """Every option of a group, in its folders too (`paper/sr_6dof_snr50`); a leading underscore marks no option."""
    for place in _places(config_dir):
        for file in sorted((place / group).rglob("*.yaml")):
            if not file.name.startswith("_"):
                yield file.relative_to(place / group).with_suffix("").as_posix()


def group_names(config_dir: str | None = None) -> list[str]:
    """Every group that is not one of Hydra's, in alphabetical order."""
    folders = {folder.name for place in _places(config_dir) for folder in place.iterdir() if folder.is_dir()}
    return sorted(name for name in folders if name != "hydra" and next(option_names(name, config_dir), None))


def options_with(setting: str) -> list[str]:
    """The choices that have a setting: `data.path` is a setting of `data=csv`."""
    group, _, key = setting.partition(".")
    (shipped,) = _places(None)
    options = option_names(group) if key and group not in ("experiment", "hydra") else ()
    return [f"{group}={option}" for option in options if key in _settings_of(shipped / group, option)]


def setting_names(overrides: Sequence[str], config_dir: str | None = None) -> list[str]:
    """All settings and groups as a user types them, under these overrides, or by default if they do not compose."""
    from pinn_cli.cli.prepare import compose_config  # not for --help

    try:
        config = compose_config(overrides, config_dir)
    except (HydraException, OmegaConfBaseException, ValueError):
        config = compose_config([], config_dir)
    return [*_names(_plain(config)), "experiment"]


def _places(config_dir: str | None) -> list[Path]:
    shipped = Path(str(files("pinn_cli.conf") / "config.yaml")).parent
    return [shipped, *([Path(config_dir)] if config_dir else [])]


def _settings_of(folder: Path, option: str) -> set[str]:
    """Of a file of a group, and of the files of the same group that it is based on."""
    node = _plain(OmegaConf.load(folder / f"{option}.yaml"))
    bases = [name for name in node.pop("defaults", []) if name != "_self_"]
    return set(_names(node)).union(*(_settings_of(folder, base) for base in bases))


def _plain(config: Any) -> Any:
    return OmegaConf.to_container(config, resolve=False)


def _names(node: Any, prefix: str = "") -> Iterator[str]:
    """Of the settings in a mapping and in those within it."""
    for key, value in node.items():
        if not str(key).startswith("_"):
            yield f"{prefix}{key}"
            if isinstance(value, dict):
                yield from _names(value, f"{prefix}{key}.")
