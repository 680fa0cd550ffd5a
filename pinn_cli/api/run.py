"""`run`, `inspect`, `modes`, `population`: what the command does, in this process, with values and exceptions.

What a run sets in its process (:mod:`pinn_cli.runs.process`) is afterwards as it was.
"""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
import weakref
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, overload

from omegaconf import DictConfig

from pinn_cli.api.data import settings_of
from pinn_cli.api.results import Result, SweepResult, load
from pinn_cli.cli.command_line import REPORTED, WITHOUT_LOGS, Jobs, Task, perform
from pinn_cli.cli.job import leave, look
from pinn_cli.cli.options import settings_of_files
from pinn_cli.cli.terminal import SILENCE
from pinn_cli.main import run as run_job
from pinn_cli.runs.claim import current
from pinn_cli.runs.interruption import watched
from pinn_cli.runs.process import borrowed
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import quoted, setting_of

if TYPE_CHECKING:
    from pinn_cli.inspection.mode_report import ModesReport
    from pinn_cli.inspection.report import InspectionReport, LookReport
    from pinn_cli.sweep.population import PopulationReport

# A second thread waits.
ONE_AT_A_TIME = threading.Lock()
# The process has logs of its own, which Hydra would replace.
_ELSEWHERE = {
    "collect": "pinn_cli.load(DIRECTORY) puts a sweep together",
    "hydra.run.dir": "directory=... is an argument",
    "hydra.sweep.dir": "directory=... is an argument",
}


class _Given(TypedDict, total=False):
    """Arguments of :func:`run` that say nothing of what it returns."""

    data: Any
    directory: str | os.PathLike[str] | None
    keep: bool
    config_dir: str | os.PathLike[str] | None


@overload
def run(*overrides: str, multirun: Literal[False] = False, **given: Unpack[_Given]) -> Result: ...
@overload
def run(*overrides: str, multirun: Literal[True], **given: Unpack[_Given]) -> SweepResult: ...
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
    """Where the command with these `sys.argv` leaves its results. Its errors are raised; the process is as it was."""
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


def inspect(
    data: Any = None,
    *overrides: str,
    directory: str | os.PathLike[str] | None = None,
    config_dir: str | os.PathLike[str] | None = None,
) -> InspectionReport:
    """Look at a record before anything is estimated, as ``pinn-run inspect`` does.

    Args:
        data: The path of a file, or a record in memory as :func:`pinn_cli.run` takes it: a pandas DataFrame, names to
            arrays, a :class:`pinn_cli.Record`, or time series as SDyPy's SEP 5 has them. What columns are is guessed
            by their names and units unless they or overrides say it. None: overrides say all.
        *overrides: Settings as the command takes them: ``"data.acceleration={1: a1}"``, ``"data.start=2"``.
        directory: Where tables and figures are written; None: nothing is.
        config_dir: A folder of more configurations.

    Returns:
        ``channels``, ``peaks`` and ``spectra`` (pandas), ``notes``, ``settings`` to run with, and ``figure()``.

    Raises:
        InputError: There is no record that can be looked at; the message is the command's one line.
        WriteError: The disk does not take what is written.

    Example:
        >>> from pinn_cli import inspect, run
        >>> found = inspect("rig.csv")  # doctest: +SKIP
        >>> found.channels  # doctest: +SKIP
        >>> result = run(*found.settings)  # doctest: +SKIP
    """
    return _looked("inspect", data, overrides, directory, config_dir)


def modes(
    data: Any = None,
    *overrides: str,
    directory: str | os.PathLike[str] | None = None,
    config_dir: str | os.PathLike[str] | None = None,
) -> ModesReport:
    """Natural frequencies, damping ratios and shapes from records alone, as ``pinn-run modes`` finds them.

    Args:
        data: See :func:`inspect`; a list of frames is several records.
        *overrides: Settings as the command takes them. With the parameters of a structure (``"system=linear"``,
            ``"system.k=4e4"``, ...) its modes stand beside.
        directory: Where tables and figures are written; None: nothing is.
        config_dir: A folder of more configurations.

    Returns:
        ``modes``, ``mac`` and ``spectra`` (pandas), and ``figure()``.

    Raises:
        InputError: There is no record with a sensor of the motion; the message is the command's one line.
        WriteError: The disk does not take what is written.
    """
    return _looked("modes", data, overrides, directory, config_dir)


def population(*runs: str | os.PathLike[str], directory: str | os.PathLike[str] | None = None) -> PopulationReport:
    """Similar structures together, as ``pinn-run population`` has them.

    Args:
        *runs: Directories of finished runs, one for each structure, or of sweeps.
        directory: Where tables and figures are written; None: nothing is.

    Returns:
        ``structures`` and ``mean`` (pandas), and ``figure()``.

    Raises:
        InputError: They are no finished runs, fewer than three can be used, or they have no parameters in common.
        WriteError: The disk does not take what is written.
    """
    places = [os.fspath(Path(run).expanduser().absolute()) for run in runs]
    return _looked("population", None, places, directory, None)


def _looked(
    word: str,
    data: Any,
    overrides: Sequence[str],
    directory: str | os.PathLike[str] | None,
    config_dir: str | os.PathLike[str] | None,
) -> Any:
    """What the command of this word finds."""
    check_overrides(overrides, word)
    kept: list[LookReport] = []

    def task(composed: DictConfig) -> None:
        kept.append(look(word, composed))
        if directory is None:
            current().untouched = True
        else:
            leave(kept[0], composed)

    with (
        tempfile.TemporaryDirectory(prefix="pinn-run-") as nowhere,
        ONE_AT_A_TIME,
        _settings(data, overrides) as of_data,
    ):
        place = Path(nowhere) / "look" if directory is None else Path(directory).expanduser().absolute()
        options = [] if config_dir is None else ["--config-dir", os.fspath(config_dir)]
        performed(task, ["pinn-run", *options, word, *of_data, *overrides, f"hydra.run.dir={quoted(str(place))}"])
    return kept[0]


@contextmanager
def _settings(data: Any, overrides: Sequence[str]) -> Iterator[list[str]]:
    """The settings that have a look read some data; what names do not say is guessed."""
    from pinn_cli.record.record import Record

    if isinstance(data, str | os.PathLike):
        yield settings_of_files([os.fspath(Path(data).expanduser())], overrides)
        return
    if isinstance(data, list | tuple) and any(isinstance(item, str | os.PathLike) for item in data):
        hint = "several records: 'data=csv', 'data.records=[{path: a.csv}, {path: b.csv}]'"
        raise InputError("data", f"a list of {len(data)}", "the path of one file, or frames", hint)
    # A structure that has the names of its DOFs may be unknown as yet: numbers are always good.
    records = data if isinstance(data, list | tuple) else [data]
    plain = [replace(record, dofs=()) if isinstance(record, Record) else record for record in records]
    with settings_of(plain if isinstance(data, list | tuple) else plain[0], overrides, lambda names: None) as settings:
        yield settings
