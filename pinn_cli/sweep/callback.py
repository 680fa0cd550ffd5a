"""The sweep that runs in this process: noted, so that it is shown, collected, and taken back if all is refused."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.runs.claim import check_destination, is_prepared, reason
from pinn_cli.runs.lock import SWEEP_FILE, held
from pinn_cli.runs.resume import RESULT
from pinn_cli.runs.writing import WriteError, content_of, put_back, write_text
from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.failure import FILE, INPUT
from pinn_cli.sweep.jobs import FINISHED, OVERRIDES, STORED, Job, Sweep
from pinn_cli.sweep.progress import Progress

# What a sweep writes before its jobs have been checked: its own configuration, a search's trials.
_EARLY = (STORED, "search.db")
_SUBMITTED = ".submitit"
_NEVER = (0, 0, 0)


@dataclass(frozen=True)
class Before:
    """What a sweep's directory held before it began: a sweep whose every job is refused leaves it as it was.

    Attributes:
        directory: Of the sweep.
        entries: What lay in it, and in the folder of a scheduler's files.
        contents: Of the files that may be written before any job is found good; None: there was none.
        moments: By job, when the files that say how far it is were written, in nanoseconds.
    """

    directory: Path
    entries: frozenset[Path]
    contents: dict[Path, bytes | None]
    moments: dict[Path, tuple[int, ...]]

    @classmethod
    def of(cls, sweep: Sweep) -> Before:
        """As it is now."""
        directory = sweep.directory
        entries = frozenset(_entries(directory))
        places = {directory / name for name in sweep.expected} | {file.parent for file in directory.glob("*/.hydra")}
        files = [*(directory / name for name in _EARLY), *(place / FILE for place in places)]
        return cls(directory, entries, {file: _content(file) for file in files}, {p: _moments(p) for p in places})

    def begun(self, jobs: Sequence[Job]) -> list[Job]:
        """The jobs that the sweep has begun, or refused, since."""
        return [job for job in jobs if _moments(job.directory) != self.moments.get(job.directory, _NEVER)]

    def is_refused(self, sweep: Sweep, jobs: Sequence[Job]) -> bool:
        """Whether no input of any job of the sweep was good."""
        names = {sweep.directory / name for name in sweep.expected}
        finished = any(job.status == FINISHED for job in jobs if job.directory in names)
        begun = self.begun(jobs)
        return bool(begun) and not finished and all(job.exit_status == INPUT for job in begun)

    def restore(self) -> None:
        """Have the directory be as it was, but for jobs that had begun."""
        for file, content in self.contents.items():
            with suppress(OSError, WriteError):  # a place that is none has nothing
                put_back(file, content)
        for entry in _entries(self.directory):
            if entry not in self.entries and entry.is_dir():
                _remove(entry)


def _entries(directory: Path) -> list[Path]:
    found = [directory / name for name in _names(directory)]
    return [*found, *(directory / _SUBMITTED / name for name in _names(directory / _SUBMITTED))]


def _moments(job: Path) -> tuple[int, ...]:
    return tuple(map(_moment, (job / OVERRIDES, job / FILE, job / RESULT)))


def _moment(file: Path) -> int:
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return 0


def _names(directory: Path) -> list[str]:
    try:
        return os.listdir(directory)
    except OSError:
        return []


def _content(file: Path) -> bytes | None:
    try:
        return content_of(file)
    except OSError:
        return None


def _remove(directory: Path) -> None:
    """A job's directory in which nothing was begun, or what a scheduler was to be given."""
    scheduler = _SUBMITTED in (directory.name, directory.parent.name)
    if scheduler or all(is_prepared(entry) for entry in directory.iterdir()):
        shutil.rmtree(directory, ignore_errors=True)


# The sweep that runs in this process, what its directory held before, and what shows how far it is.
_running: tuple[Sweep, Before, Progress] | None = None
# What keeps other processes out of its directory.
_held = ExitStack()


def note_sweep(config: DictConfig) -> None:
    """Keep the names of the settings that are swept for the jobs, whose configurations have overrides of their own."""
    with suppress(OmegaConfBaseException):  # where it is made of what only a job has, such as ${hydra.job.num}
        str(config.hydra.sweep.subdir)


def begin_sweep(config: Any) -> None:
    """Enter a sweep's directory, once no other process is there, leave the configuration in it and show the progress.

    Args:
        config: With its `hydra` node; its overrides have been found good.

    Raises:
        InputError: The directory is none that a sweep may write into.
    """
    global _running  # noqa: PLW0603
    setting, directory = "hydra.sweep.dir", Path(str(config.hydra.sweep.dir))
    if not config.hydra.sweep.dir:
        raise InputError(setting, config.hydra.sweep.dir, "a directory")
    sweep = Sweep.of(config, directory)
    check_destination(directory, setting)
    try:
        _held.enter_context(held(directory, SWEEP_FILE))
        progress = Progress(sweep)
        _running = sweep, Before.of(sweep), progress
        write_text(OmegaConf.to_yaml(config), directory / STORED)
    except (OSError, WriteError) as error:
        raise InputError(setting, directory, "a directory that can be written to", reason(error)) from error
    progress.start()


def ended_sweep() -> tuple[Sweep, Before] | None:
    """The sweep that ran, or was cut off, in this process, and what was there before; its progress is shown no more."""
    global _running  # noqa: PLW0603
    if _running is None:
        return None
    sweep, before, progress = _running
    _running = None
    progress.stop()
    return sweep, before


def leave_sweep() -> None:
    """Let others into its directory."""
    _held.close()
