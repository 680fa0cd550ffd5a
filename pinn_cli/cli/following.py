"""`pinn-run follow data=...`: a run by windows of a record that is still being measured."""

from __future__ import annotations

from argparse import Namespace

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of

COMMAND = "follow"
# The same at every start, so that the same command goes on.
DIRECTORY = "hydra.run.dir=outputs/${case}/follow"
_LEFT_OUT = ("resume", "collect")


def taken_out(arguments: list[str], options: Namespace) -> bool:
    """Whether the command line says `follow`; the word is taken out of it, and what goes ill with it is refused.

    Args:
        arguments: `sys.argv`, changed in place.
        options: As read, changed in place.

    Raises:
        InputError: Something else is asked for along with it.
    """
    if COMMAND not in options.overrides:
        return False
    if options.multirun:
        raise InputError("--multirun", COMMAND, f"left out with {COMMAND}", "one record is followed at a time")
    for override in options.overrides:
        name = setting_of(override)
        if name in _LEFT_OUT:
            hint = "the same command goes on where it was"
            raise InputError(name, override.partition("=")[2], f"left out with {COMMAND}", hint)
    options.overrides.remove(COMMAND)
    arguments.remove(COMMAND)
    if not any(setting_of(override) == "hydra.run.dir" for override in options.overrides):
        options.overrides.append(DIRECTORY)
        arguments.append(DIRECTORY)
    return True
