"""Files of settings that may be anybody's, read by themselves or as a folder that Hydra searches.

What is wrong with one is told with the file and the line. A few lines of YAML can name each other so often that no
memory holds what they say, or name themselves: so aliases (`*name`) are none.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

import yaml
from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.settings.errors import InputError

# The largest file that comes with the program has 12 kB and 5 levels.
MOST_YAML_BYTES, MOST_LEVELS = 2**20, 50
SCHEME, ENDING = "folder", ".yaml"


class ConfigFolder(ConfigSource):
    """A folder of configurations of somebody's own, `folder://FOLDER`, whose files are checked when they are read.

    See :class:`hydra.plugins.config_source.ConfigSource`, of which all methods are.
    """

    @staticmethod
    def scheme() -> str:
        """What stands before `://`."""
        return SCHEME

    def load_config(self, config_path: str) -> ConfigResult:
        """Read a file.

        Raises:
            InputError: See :func:`read_yaml`; or its defaults name itself.
        """
        file = self._file(config_path)
        if not file.is_file():
            raise ConfigLoadError(f"Config not found : {file}")
        config, package = read_yaml(file), re.search(r"\A(?:\s|#.*\n)*?#\s*@package\s+(\S+)", _text(file))
        defaults = OmegaConf.to_container(config, resolve=False).get("defaults")  # type: ignore[union-attr]
        if isinstance(defaults, list) and file.stem in defaults:
            raise InputError(f"{file}, defaults", file.stem, "another file", "a file does not include itself")
        header = {"package": package[1] if package else None}
        return ConfigResult(self.provider, f"{SCHEME}://{self.path}", config, header)

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
        entries = list((Path(self.path) / config_path).iterdir())
        groups = {entry.name for entry in entries if entry.is_dir()}
        configs = {entry.stem for entry in entries if entry.suffix == ENDING and entry.is_file()}
        kinds = {ObjectType.GROUP: groups, ObjectType.CONFIG: configs}
        return sorted(groups | configs if results_filter is None else kinds[results_filter])

    def _file(self, config_path: str) -> Path:
        return Path(self.path) / (config_path if config_path.endswith(ENDING) else f"{config_path}{ENDING}")


def read_yaml(file: Path) -> DictConfig:
    """The settings that a file holds, which exists.

    Raises:
        InputError: Naming the file, and where there is one the line: it cannot be read, is no UTF-8 or no YAML, holds
            something else than settings, is nested too deeply, or has aliases.
    """
    text = _text(file)
    try:
        _check_structure(file, text)
        return OmegaConf.load(io.StringIO(text))  # type: ignore[return-value]
    except yaml.YAMLError as error:
        raise _bad_yaml(file, text, error) from None
    except OmegaConfBaseException as error:
        raise InputError(str(file), "(as it is)", "settings", str(error).partition("\n")[0]) from None


def _text(file: Path) -> str:
    try:
        with file.open("rb") as opened:
            content = opened.read(MOST_YAML_BYTES + 1)
    except OSError as error:
        raise InputError(str(file), "(unreadable)", "a file that can be read", error.strerror or str(error)) from None
    if len(content) > MOST_YAML_BYTES:
        raise InputError(str(file), "(too long)", f"at most {MOST_YAML_BYTES} bytes long", "it is no file of settings")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        hint = "save it as UTF-8 in your editor"
        raise InputError(f"{file}, line {line}", f"byte {content[error.start]:#04x}", "UTF-8 text", hint) from None


def _check_structure(file: Path, text: str) -> None:
    level = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        where = f"{file}, line {event.start_mark.line + 1}"
        if isinstance(event, yaml.AliasEvent):
            hint = "aliases are not read; ${a.b} names the setting b of a"
            raise InputError(where, f"*{event.anchor}", "written out", hint)
        if level == 0 and isinstance(event, yaml.NodeEvent) and not isinstance(event, yaml.MappingStartEvent):
            shown = text.strip().partition("\n")[0]
            shown = shown if len(shown) < 60 else f"{shown[:60]}..."
            raise InputError(str(file), shown, "settings, as in `depth: 3`")
        level += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if level > MOST_LEVELS:
            raise InputError(where, "(nested)", f"nested in at most {MOST_LEVELS} levels")


def _bad_yaml(file: Path, text: str, error: yaml.YAMLError) -> InputError:
    mark = getattr(error, "problem_mark", None)
    if mark is None:  # of a character that is none in YAML
        at = int(getattr(error, "position", 0))
        line, column = text.count("\n", 0, at), 0
        problem = f"the character {text[at : at + 1]!r} is not allowed"
    else:
        line, column, problem = mark.line, mark.column, str(getattr(error, "problem", "") or error)
        begun = getattr(error, "context_mark", None)
        if begun is not None and begun.line != line:
            problem += f", {getattr(error, 'context', '')} of line {begun.line + 1}"
    lines = text.splitlines()
    shown = lines[line] if line < len(lines) else "(its end)"
    if "\t" in shown[: column + 1]:
        problem = "indent with spaces, not with tabs"
    return InputError(f"{file}, line {line + 1}", shown.strip(), "YAML", problem)
