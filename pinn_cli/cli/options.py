"""The options of `pinn-run`, which begin with a dash, and its subcommands: `inspect`, `modes`, `follow`, `population`.

They are read before Hydra reads them: a slip is told in one line. `--config my.yaml` has the settings of one command in
a file, as overrides before those that are typed.
"""

from __future__ import annotations

import re
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from omegaconf import OmegaConf

from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.override_syntax import setting_of, text_value, with_folder_quoted
from pinn_cli.settings.yaml_file import read_yaml

# Those of Hydra's, which has no public list of them: `pinn-run --hydra-help` prints them. Long name, short name,
# and how argparse reads them; those without take no value. Left out are --experimental-rerun, which unpickles the file
# that it is given, --config-path, which imports a package, --config-name, which would have another main configuration,
# and --info, which would act on a configuration before it is checked.
OPTIONS: dict[tuple[str, ...], dict[str, Any]] = {
    ("--help", "-h"): {},
    ("--hydra-help",): {},
    ("--version",): {},
    ("--cfg", "-c"): {"choices": ("job", "hydra", "all")},
    ("--resolve",): {},
    ("--package", "-p"): {"nargs": None},
    ("--run", "-r"): {},
    ("--multirun", "-m"): {},
    ("--config-dir", "-cd"): {"nargs": None},
    ("--shell-completion", "-sc"): {},
}
# Ours alone.
OWN_OPTIONS: dict[tuple[str, ...], dict[str, Any]] = {
    ("--config",): {"nargs": None},
    ("--quiet", "-q"): {},
    ("--json",): {},
    ("--json-schema",): {},
}
_EXCLUSIVE = ("run", "multirun", "cfg", "shell_completion")
# Settings that go ill with a subcommand, and what is to be known of it.
_GO_ILL = {
    # What goes on with a run, or makes several, has nothing to do with a look at a record.
    "inspect": (("resume", "collect", "model"), "one record is looked at at a time"),
    "modes": (("resume", "collect", "model"), "modes are those that records show by themselves"),
    "follow": (("resume", "collect"), "one record is followed at a time; the same command goes on where it was"),
    "population": (("resume", "collect", "model", "data"), "runs are named by their directories"),
}
SUBCOMMANDS = tuple(_GO_ILL)
# Of a followed record the same at every start, so that the same command goes on.
_FOLLOWS_IN = "hydra.run.dir=outputs/${case}/follow"


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """What argparse says, as setting, value and what is allowed."""
        unknown = re.match(r"unrecognized arguments: (\S+)", message)
        if unknown:
            options = [name for names in (*OPTIONS, *OWN_OPTIONS) for name in names]
            raise InputError("option", unknown[1], "one that pinn-run --help lists", suggestion(unknown[1], options))
        choice = re.match(r"argument ([^:]+): invalid choice: '?([^' ]*)'? \(choose from (.*)\)", message)
        if choice:
            raise InputError(choice[1], choice[2], f"one of {choice[3]}".replace("'", ""))
        raise InputError("options", message, "as pinn-run --help shows them")


def read_options(arguments: Sequence[str]) -> Namespace:
    """Check the process's arguments, without the name of the program.

    Returns:
        The options as Hydra names them; `overrides` is the list of `setting=value`, and `subcommand` the word among
        them that is one, "": none.

    Raises:
        InputError: An option is unknown, lacks its value, or excludes another; or a setting goes ill with a subcommand.
        SystemExit: After printing the version, if that was asked for.
    """
    if "--version" in arguments:
        print(f"pinn-run {version('pinn-cli')}")
        sys.exit(0)
    parser = _Parser(add_help=False, allow_abbrev=False)
    parser.add_argument("overrides", nargs="*")
    for names, settings in (OPTIONS | OWN_OPTIONS).items():
        parser.add_argument(*names, **(settings or {"action": "store_true"}))
    options = parser.parse_intermixed_args(arguments)
    options.overrides = [with_folder_quoted(override) for override in options.overrides]
    chosen = [name for name in _EXCLUSIVE if getattr(options, name)]
    if len(chosen) > 1:
        raise InputError("options", " ".join(f"--{name}" for name in chosen), "one of them at a time")
    if options.json and (options.multirun or options.cfg):
        raise InputError("--json", "given", "left out with --multirun and --cfg", "it prints what one run has found")
    if options.config is not None:
        options.overrides = [*overrides_of(options.config, options.overrides), *options.overrides]
    options.subcommand = next((word for word in _GO_ILL if word in options.overrides), "")
    if options.subcommand:
        _take_out(options, options.subcommand)
    return options


def _take_out(options: Namespace, word: str) -> None:
    """Take a subcommand out of the overrides, and refuse what goes ill with it."""
    left_out, hint = _GO_ILL[word]
    if options.multirun:
        raise InputError("--multirun", word, f"left out with {word}", hint)
    for override in options.overrides:
        if setting_of(override) in left_out:
            raise InputError(setting_of(override), override.partition("=")[2], f"left out with {word}", hint)
    options.overrides.remove(word)
    files = [name for name in options.overrides if "=" not in name and not name.startswith("~")]
    if word == "population":  # `population A B` is `model=[A,B]`; directories of a sweep's jobs have equals signs
        files = [name for name in options.overrides if name in files or Path(name).is_dir()]
        others = [override for override in options.overrides if override not in files]
        named = [] if any(setting_of(override) == "case" for override in others) else ["case=population"]
        options.overrides = [*named, f"model={written(files)}", *others]
    if word in ("inspect", "modes") and files:  # `inspect rig.csv` is `data=csv data.path=rig.csv`
        others = [override for override in options.overrides if override not in files]
        options.overrides = [*settings_of_files(files, others), *others]
    if word == "follow" and not any(setting_of(o) == setting_of(_FOLLOWS_IN) for o in options.overrides):
        options.overrides.append(_FOLLOWS_IN)


def settings_of_files(files: Sequence[str], others: Sequence[str]) -> list[str]:
    """What has a record read from files on one clock, whose format is recognised unless another override says it.

    A file that is missing, or in no format that anybody here reads, is refused.
    """
    from pinn_cli.record.clock import recognised  # not for other commands: it imports NumPy

    formats = [recognised(Path(file)) for file in files]
    kind = [] if any(setting_of(override) == "data" for override in others) else [f"data={formats[0].name}"]
    return [*kind, f"data.path={written(files[0] if len(files) == 1 else list(files))}"]


def overrides_of(file: str, typed: Sequence[str]) -> list[str]:
    """What a file says, but for settings that are typed, too.

    ``system: linear`` chooses an option, ``system: {ndof: 3}`` and ``system.ndof: 3`` set one of its settings; a
    list of ``defaults``, as an experiment has it, chooses options.

    Raises:
        InputError: There is no such file, or it holds something else than settings.
    """
    path = Path(file)
    if not path.is_file():
        allowed = "a file of settings (YAML) that exists"
        raise InputError("--config", file or "''", allowed, "--config-dir takes a folder")
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
        keys = [re.sub(r"([\\()\[\]{}:=, \t])", r"\\\1", str(key)) for key in value]
        return "{" + ", ".join(f"{k}: {written(part)}" for k, part in zip(keys, value.values(), strict=True)) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(written, value)) + "]"
    return str(value)
