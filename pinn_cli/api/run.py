"""`run`: what the command `pinn-run` does, in this process, with results as values and errors as exceptions."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
import weakref
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Literal, overload

from pinn_cli.api.data import settings_of
from pinn_cli.api.results import Result, SweepResult, load
from pinn_cli.cli.command_line import REPORTED, WITHOUT_LOGS, Jobs, Task, perform
from pinn_cli.cli.terminal import SILENCE
from pinn_cli.main import run as run_job
from pinn_cli.runs.interruption import watched
from pinn_cli.runs.process import borrowed
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import quoted, setting_of

# A run sets what belongs to the process (:mod:`pinn_cli.runs.process`): a second thread waits.
ONE_AT_A_TIME = threading.Lock()
# The process has logs of its own, which Hydra would replace.
_ELSEWHERE = {
    "collect": "pinn_cli.load(DIRECTORY) puts a sweep together",
    "hydra.run.dir": "directory=... is an argument",
    "hydra.sweep.dir": "directory=... is an argument",
}


@overload
def run(
    *overrides: str,
    data: Any = None,
    directory: str | os.PathLike[str] | None = None,
    keep: bool = True,
    config_dir: str | os.PathLike[str] | None = None,
    multirun: Literal[False] = False,
) -> Result: ...


@overload
def run(
    *overrides: str,
    data: Any = None,
    directory: str | os.PathLike[str] | None = None,
    keep: bool = True,
    config_dir: str | os.PathLike[str] | None = None,
    multirun: Literal[True],
) -> SweepResult: ...


def run(
    *overrides: str,
    data: Any = None,
    directory: str | os.PathLike[str] | None = None,
    keep: bool = True,
    config_dir: str | os.PathLike[str] | None = None,
    multirun: bool = False,
) -> Result | SweepResult:
    """Estimate the response and the parameters of a structure: ``pinn-run OVERRIDES`` in this process.

    It computes what the command computes, to the last bit, and leaves the same files behind. What a run sets in its
    process (threads, logs, random generators, Hydra) is afterwards as it was. Runs of several threads wait for each
    other.

    Args:
        *overrides: Settings as the command takes them, without the shell's quotes: ``"system.ndof=3"``,
            ``"data.force={1: f1}"``.
        data: A measured record in memory. A pandas DataFrame, names to arrays, or a :class:`pinn_cli.Record`; a list
            of them is several records of one structure, solved together. Columns are named by what they measure, at
            which DOF (from 1): ``t`` (s; or the frame's index), ``force.1`` (N), ``acceleration.3`` (m/s^2),
            ``velocity.3``, ``displacement.3``, ``ground_acceleration``. Other units stand in brackets,
            ``acceleration.3 (g)``, in ``frame.attrs["units"]``, or are pint's. Columns of other names are told by
            overrides, as those of a file: ``"data.acceleration={3: roof}"``.
        directory: Where the results lie; None: ``outputs/<case>/<time>``, a sweep's ``outputs/sweeps/<settings>``.
        keep: Whether they stay; False: they lie in a temporary folder that goes with the result.
        config_dir: A folder of more configurations.
        multirun: Whether commas in settings (``"seed=0,1,2"``) make a sweep of several runs.

    Returns:
        The result, or of a sweep those of its runs.

    Raises:
        InputError: No run can use the input; nothing is left of it. The message is the command's one line.
        DivergenceError: The training left the numbers that a computer can hold.
        WriteError: The disk takes no more.
        NotSoundError: The verdict is not sound, with ``"strict=true"``; the results are written.
        KeyboardInterrupt: It was interrupted; the run keeps a checkpoint, ``run("resume=DIRECTORY")`` goes on.

    Example:
        >>> from pinn_cli import run
        >>> result = run("system.ndof=2", "simulation.samples=256", keep=False)  # doctest: +SKIP
        >>> result.verdict  # doctest: +SKIP
        'sound'
    """
    check_overrides(overrides, "run")
    if directory is not None and not keep:
        raise InputError("directory", directory, "left out with keep=False", "nothing is kept there")
    place = None if directory is None else Path(directory).expanduser().absolute()
    with ExitStack() as on_failure:
        temporary = None if keep else Path(tempfile.mkdtemp(prefix="pinn-run-"))
        if temporary is not None:
            place = temporary / "result"
            on_failure.callback(shutil.rmtree, temporary, ignore_errors=True)
        with ONE_AT_A_TIME, settings_of(data, overrides) as of_data:
            arguments = ["pinn-run", *(["--multirun"] if multirun else []), *of_data, *overrides]
            if config_dir is not None:
                arguments[1:1] = ["--config-dir", os.fspath(config_dir)]
            if place is not None:
                arguments.append(f"hydra.{'sweep' if multirun else 'run'}.dir={quoted(str(place))}")
            result = load(performed(partial(run_job, terminal=SILENCE), arguments))
        on_failure.pop_all()
    if temporary is not None:
        weakref.finalize(result, shutil.rmtree, temporary, ignore_errors=True)
    return result


def check_overrides(overrides: Sequence[str], function: str) -> None:
    """See that what a function was given are settings, and none that are arguments in Python.

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
    """The directory in which the command leaves its results. Its errors are raised; the process is as it was.

    Args:
        task: Called with the composed configuration.
        arguments: As `sys.argv` has them.
    """
    jobs = Jobs(task, SILENCE, of_hydra=WITHOUT_LOGS)
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
