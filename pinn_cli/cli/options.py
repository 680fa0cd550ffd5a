"""The options of `pinn-run`, which begin with a dash, and its subcommands, `inspect` and `follow`.

They are read before Hydra reads them: a slip is told in one line.
"""

from __future__ import annotations

import re
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, NoReturn

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.settings.suggestion import suggestion

_EXCLUSIVE = ("run", "multirun", "cfg", "info", "shell_completion")
# Hydra's options, which it has no public list of: `pinn-run --hydra-help` prints them. Long name, short name, and how
# argparse reads them; those without take no value. Three are left out: --experimental-rerun unpickles the file that it
# is given, --config-path imports a package, and --config-name would have another main configuration.
_INFO = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
_OPTIONS: dict[tuple[str, ...], dict[str, Any]] = {
    ("--help", "-h"): {},
    ("--hydra-help",): {},
    ("--version",): {},
    ("--cfg", "-c"): {"choices": ("job", "hydra", "all")},
    ("--resolve",): {},
    ("--package", "-p"): {"nargs": None},
    ("--run", "-r"): {},
    ("--multirun", "-m"): {},
    ("--shell-completion", "-sc"): {},
    ("--config-dir", "-cd"): {"nargs": None},
    ("--info", "-i"): {"const": "all", "nargs": "?", "choices": _INFO},
}


def read_options(arguments: Sequence[str]) -> Namespace:
    """Check the process's arguments.

    Args:
        arguments: Without the name of the program.

    Returns:
        The options as Hydra names them; `overrides` is the list of `setting=value`.

    Raises:
        InputError: An option is unknown, lacks its value, or excludes another.
        SystemExit: After printing the version, if that was asked for.
    """
    if "--version" in arguments:
        print(f"pinn-run {version('pinn-cli')}")
        sys.exit(0)
    options = _parser().parse_intermixed_args(arguments)
    chosen = [name for name in _EXCLUSIVE if getattr(options, name)]
    if len(chosen) > 1:
        raise InputError("options", " ".join(f"--{name}" for name in chosen), "one of them at a time")
    return options


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise _refused(message, [name for names in _OPTIONS for name in names])


def _parser() -> _Parser:
    parser = _Parser(add_help=False)
    parser.add_argument("overrides", nargs="*")
    for names, settings in _OPTIONS.items():
        parser.add_argument(*names, **(settings or {"action": "store_true"}))
    return parser


def _refused(message: str, known: list[str]) -> InputError:
    """What argparse says, as setting, value and what is allowed."""
    unknown = re.match(r"unrecognized arguments: (\S+)", message)
    if unknown:
        return InputError("option", unknown[1], "one that pinn-run --help lists", suggestion(unknown[1], known))
    choice = re.match(r"argument ([^:]+): invalid choice: '?([^' ]*)'? \(choose from (.*)\)", message)
    if choice:
        return InputError(choice[1], choice[2], f"one of {choice[3]}".replace("'", ""))
    return InputError("options", message, "as pinn-run --help shows them")


@dataclass(frozen=True)
class Subcommand:
    """A word among the overrides.

    Attributes:
        word: It.
        left_out: Settings that go ill with it.
        one_at_a_time: Why there is no sweep of it.
        hint: What to do instead of giving one of those settings.
        directory: Override of the run's directory, unless the command line has one; "": none.
    """

    word: str
    left_out: tuple[str, ...]
    one_at_a_time: str
    hint: str = ""
    directory: str = ""

    def taken_out(self, options: Namespace) -> bool:
        """Whether the command line says it; the word is taken out of it, and what goes ill with it is refused.

        Args:
            options: As read, changed in place.

        Raises:
            InputError: Something else is asked for along with it.
        """
        if self.word not in options.overrides:
            return False
        if options.multirun:
            raise InputError("--multirun", self.word, f"left out with {self.word}", self.one_at_a_time)
        for override in options.overrides:
            name = setting_of(override)
            if name in self.left_out:
                raise InputError(name, override.partition("=")[2], f"left out with {self.word}", self.hint)
        options.overrides.remove(self.word)
        if self.directory and not any(setting_of(o) == setting_of(self.directory) for o in options.overrides):
            options.overrides.append(self.directory)
        return True


# What goes on with a run, or makes several, has nothing to do with a look at a record.
INSPECT = Subcommand("inspect", ("resume", "collect", "model"), "one record is looked at at a time")
# Its directory is the same at every start, so that the same command goes on.
FOLLOW = Subcommand(
    "follow",
    ("resume", "collect"),
    "one record is followed at a time",
    "the same command goes on where it was",
    "hydra.run.dir=outputs/${case}/follow",
)
