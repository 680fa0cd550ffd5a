"""Reading a YAML file of settings that may be anybody's: what is wrong is told with the file and the line.

A few lines of YAML can name each other so often that no memory holds what they say, or name themselves. So the file is
first read as a graph, in which every name stands once, and what it would unfold to is counted.
"""

from __future__ import annotations

import io
from pathlib import Path

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.settings.errors import InputError

# The largest file that comes with the program has 12 kB, 200 entries and 5 levels.
MOST_BYTES, MOST_ENTRIES, MOST_LEVELS = 2**20, 100_000, 50


def read_yaml(file: Path) -> DictConfig:
    """The settings that a file holds; see :func:`read_yaml_and_text`."""
    return read_yaml_and_text(file)[1]


def read_yaml_and_text(file: Path) -> tuple[str, DictConfig]:
    """The text of a file, and the settings that it holds.

    Args:
        file: That exists.

    Raises:
        InputError: Naming the file, and where there is one the line: it cannot be read, is no UTF-8 or no YAML, holds
            something else than settings, unfolds to too much, or names itself.
    """
    text = _text(file)
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        if not isinstance(root, yaml.MappingNode | None):
            raise _no_settings(file, text)
        _check_size(file, root)
        config = OmegaConf.load(io.StringIO(text))
    except yaml.YAMLError as error:
        raise _bad_yaml(file, text, error) from None
    except RecursionError:
        raise InputError(str(file), "(nested)", f"nested in at most {MOST_LEVELS} levels") from None
    except OmegaConfBaseException as error:
        raise InputError(str(file), "(as it is)", "settings", str(error).partition("\n")[0]) from None
    return text, config  # type: ignore[return-value]


def _text(file: Path) -> str:
    try:
        with file.open("rb") as opened:
            content = opened.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError(str(file), "(unreadable)", "a file that can be read", error.strerror or str(error)) from None
    if len(content) > MOST_BYTES:
        raise InputError(str(file), "(too long)", f"at most {MOST_BYTES} bytes long", "it is no file of settings")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        hint = "save it as UTF-8 in your editor"
        raise InputError(f"{file}, line {line}", f"byte {content[error.start]:#04x}", "UTF-8 text", hint) from None


def _check_size(file: Path, root: yaml.Node | None) -> None:
    """Refuse what unfolds to too many entries or levels, or never ends."""
    sizes: dict[int, int] = {}
    above: set[int] = set()

    def size(node: yaml.Node, level: int) -> int:
        where = f"{file}, line {node.start_mark.line + 1}"
        if id(node) in above:
            raise InputError(where, "*alias", "an alias of something else", "it stands within what it is an alias of")
        if level > MOST_LEVELS:
            raise InputError(where, "(nested)", f"nested in at most {MOST_LEVELS} levels")
        if id(node) not in sizes:
            above.add(id(node))
            parts = [part for pair in node.value for part in pair] if isinstance(node, yaml.MappingNode) else node.value
            sizes[id(node)] = 1 + sum(size(part, level + 1) for part in parts if isinstance(part, yaml.Node))
            above.discard(id(node))
        if sizes[id(node)] > MOST_ENTRIES:
            hint = f"with its aliases written out it has {sizes[id(node)]:.3g}"
            raise InputError(where, "(too many)", f"at most {MOST_ENTRIES} entries", hint)
        return sizes[id(node)]

    if root is not None:
        size(root, 0)


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


def _no_settings(file: Path, text: str) -> InputError:
    shown = text.strip().partition("\n")[0]
    return InputError(str(file), shown if len(shown) < 60 else f"{shown[:60]}...", "settings, as in `depth: 3`")
