"""A folder of configurations of somebody's own, as Hydra searches it, whose files are checked when they are read."""

from __future__ import annotations

import re
from pathlib import Path

from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.yaml_file import read_yaml_and_text

SCHEME, HYDRAS = "folder", "file"
ENDING = ".yaml"


def as_folder(place: str) -> str:
    """A place on a search path, `file://FOLDER` or `FOLDER`, as one that is read by :class:`ConfigFolder`."""
    scheme, found, folder = place.partition("://")
    if not found:
        return f"{SCHEME}://{place}"
    return f"{SCHEME}://{folder}" if scheme == HYDRAS else place


class ConfigFolder(ConfigSource):
    """See the module and :class:`hydra.plugins.config_source.ConfigSource`, of which all methods are."""

    @staticmethod
    def scheme() -> str:
        """What stands before `://`."""
        return SCHEME

    def load_config(self, config_path: str) -> ConfigResult:
        """Read a file.

        Raises:
            InputError: See :func:`pinn_cli.settings.yaml_file.read_yaml_and_text`; or its defaults name itself.
        """
        file = self._file(config_path)
        if not file.is_file():
            raise ConfigLoadError(f"Config not found : {file}")
        text, config = read_yaml_and_text(file)
        _check_defaults(file, config)
        return ConfigResult(self.provider, f"{SCHEME}://{self.path}", config, _header(text))

    def available(self) -> bool:
        """Whether the folder is there."""
        return self.is_group("")

    def is_group(self, config_path: str) -> bool:
        """Whether that is a folder in it."""
        return (Path(self.path) / config_path).is_dir()

    def is_config(self, config_path: str) -> bool:
        """Whether that is a file in it, with or without its ending."""
        return self._file(config_path).is_file()

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """What is in one of its folders."""
        entries = sorted((Path(self.path) / config_path).iterdir())
        groups = [entry.name for entry in entries if entry.is_dir() and entry.name != "__pycache__"]
        configs = [entry.stem for entry in entries if entry.suffix == ENDING and entry.is_file()]
        kinds = {None: [*groups, *configs], ObjectType.GROUP: groups, ObjectType.CONFIG: configs}
        return sorted(set(kinds.get(results_filter, ())))

    def _file(self, config_path: str) -> Path:
        return Path(self.path) / (config_path if config_path.endswith(ENDING) else f"{config_path}{ENDING}")


def _header(text: str) -> dict[str, str | None]:
    """What the lines before the settings say of them: `# @package _global_`."""
    found: dict[str, str | None] = {"package": None}
    for line in filter(str.strip, text.splitlines()):
        said = re.fullmatch(r"\s*#\s*@(\w+)\s+(\S+)\s*", line)
        if said is None:
            break
        found[said[1]] = said[2]
    return found


def _check_defaults(file: Path, config: DictConfig) -> None:
    plain = OmegaConf.to_container(config, resolve=False)
    defaults = plain.get("defaults") if isinstance(plain, dict) else None
    if isinstance(defaults, list) and file.stem in defaults:
        raise InputError(f"{file}, defaults", file.stem, "another file", "a file does not include itself")
