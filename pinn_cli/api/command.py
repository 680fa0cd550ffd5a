"""The command, carried out in this process: its errors are raised, and the process is given back as it was."""

from __future__ import annotations

import signal
import threading
from collections.abc import Sequence
from pathlib import Path

from pinn_cli.cli.command_line import REPORTED, WITHOUT_LOGS, Jobs, Silence, Task, perform
from pinn_cli.runs.interruption import watched
from pinn_cli.runs.process import borrowed
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of

# A run sets what belongs to the process (:mod:`pinn_cli.runs.process`): a second thread waits.
ONE_AT_A_TIME = threading.Lock()
# The process has logs of its own, which Hydra would replace.
_ELSEWHERE = {
    "collect": "pinn_cli.load(DIRECTORY) puts a sweep together",
    "hydra.run.dir": "directory=... is an argument",
    "hydra.sweep.dir": "directory=... is an argument",
}


def check_overrides(overrides: Sequence[str], function: str) -> None:
    """See that they are settings, and none that are arguments in Python.

    Args:
        overrides: As given.
        function: That they were given to.

    Raises:
        InputError: At the first that is not.
    """
    for override in overrides:
        if not isinstance(override, str):
            raise InputError("override", override, "a string such as 'system.ndof=3'")
        name = setting_of(override)
        if name in _ELSEWHERE:
            raise InputError(name, override.partition("=")[2], f"left out of {function}(...)", _ELSEWHERE[name])
        if override.startswith("-"):
            hint = "multirun=True and config_dir=... are arguments"
            raise InputError("override", override, "of the form setting=value", hint)


def performed(task: Task, arguments: Sequence[str]) -> Path:
    """The directory that the command with these arguments leaves its results in.

    Args:
        task: Called with the composed configuration.
        arguments: As `sys.argv` has them.

    Raises:
        Exception: As of :func:`pinn_cli.run`.
    """
    jobs = Jobs(task, Silence(), of_hydra=WITHOUT_LOGS)
    try:
        with borrowed(arguments):
            here = Path.cwd()
            perform(jobs, watched((signal.SIGINT,), ends=False))
    except REPORTED as error:
        raise error.with_traceback(None) from None  # of use to nobody: it leads through Hydra
    if jobs.refused and jobs.reasons:
        raise InputError.read(jobs.reasons[0])
    assert jobs.directory is not None
    return here / jobs.directory
