"""The sweep that runs in this process: it enters its directory, shows how far it is, and goes if all is refused."""

from __future__ import annotations

import importlib
import shutil
import sys
import threading
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.runs.claim import EVERY_S, SWEEP_LOCK, check_destination, held, is_prepared, writing_into
from pinn_cli.runs.reading import printable
from pinn_cli.runs.resume import RESULT
from pinn_cli.runs.writing import WriteError, content_of, put_back, write_text
from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.jobs import FAILURE, FINISHED, INPUT, STORED, Failure, Job, Sweep, job_directories, written_since

# Where a scheduler's files are, in the sweep's directory.
_SUBMITTED = ".submitit"
# What a sweep and a search write before any job's input is found good.
_EARLY = (STORED, "search.csv")


class Progress:
    """A bar on a terminal, or a line per job that ends, read off the jobs' directories: whatever runs them, and where.

    A sweep whose jobs only its sweeper knows is not watched. It began at ``since``, s since the epoch by the clock of
    its file system: what failed before is run again.
    """

    def __init__(self, sweep: Sweep, since: float) -> None:
        from tqdm import tqdm

        places = {name: sweep.directory / name for name in sweep.expected}
        self._waiting = {name: place for name, place in places.items() if not (place / RESULT).is_file()}
        self._total, self._since = len(places), since
        if len(self._waiting) < self._total:
            tell(f"{self._total - len(self._waiting)} of {self._total} jobs are finished already")
        self._bar = tqdm(
            total=self._total, initial=self._total - len(self._waiting), unit="job", dynamic_ncols=True,
            disable=_quiet or not (self._total and sys.stderr.isatty()),
        )  # fmt: skip
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="progress", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Look once more, and no more."""
        self._stop.set()
        self._thread.join()
        self._look()
        self._bar.close()

    def _watch(self) -> None:
        while self._total and not self._stop.wait(EVERY_S):
            self._look()
            if 2 * len(self._waiting) <= self._total:  # two seconds that the end of the sweep would take otherwise
                importlib.import_module("pinn_cli.sweep.summary")

    def _look(self) -> None:
        for name, place in list(self._waiting.items()):
            failure = Failure.read(place) if written_since(place, self._since, (FAILURE,)) else None
            if failure is None and not (place / RESULT).is_file():
                continue
            del self._waiting[name]
            ended = "finished" if failure is None else f"failed: {printable(failure.reason)}"
            if self._bar.disable:
                shown = f"{self._total - len(self._waiting)} of {self._total}  {printable(name)}  {ended}"
                if failure is None:
                    tell(shown)
                else:
                    print(shown, file=sys.stderr)
            elif failure is not None:
                self._bar.write(f"{name}  {ended}", file=sys.stderr)
            self._bar.update()


@dataclass(frozen=True)
class RunningSweep:
    """A sweep, and what its directory held before it began: if every job is refused it is left as it was.

    Attributes:
        sweep: The sweep.
        entries: What lay in its directory, and in the folder of a scheduler's files.
        contents: Of the files that may be written before any job's input is found good; None: there was none.
        since: When it began, s since the epoch by the clock of its file system.
        progress: What shows how far it is.
    """

    sweep: Sweep
    entries: set[Path]
    contents: dict[Path, bytes | None]
    since: float
    progress: Progress

    def begun(self, jobs: list[Job]) -> list[Job]:
        """The jobs that the sweep has begun, or refused."""
        return [job for job in jobs if written_since(job.directory, self.since)]

    def is_refused(self, jobs: list[Job], begun: list[Job]) -> bool:
        """Whether no input of any job of the sweep was good; ``begun``: those of the jobs that it has begun."""
        expected = {self.sweep.directory / name for name in self.sweep.expected}
        finished = any(job.status == FINISHED for job in jobs if job.directory in expected)
        return bool(begun) and not finished and all(job.exit_status == INPUT for job in begun)

    def restore(self) -> None:
        """Have the directory be as it was, but for jobs that had begun."""
        for file, content in self.contents.items():
            with suppress(OSError, WriteError):  # a place that is none has nothing
                put_back(file, content)
        for entry in _entries(self.sweep.directory) - self.entries:
            scheduler = _SUBMITTED in (entry.name, entry.parent.name)
            if entry.is_dir() and (scheduler or all(map(is_prepared, entry.iterdir()))):
                shutil.rmtree(entry, ignore_errors=True)


def _entries(directory: Path) -> set[Path]:
    return {*directory.glob("*"), *directory.glob(f"{_SUBMITTED}/*")}


# That of this process, what keeps other processes out of its directory, and whether the terminal is left alone.
_running: RunningSweep | None = None
_held = ExitStack()
_quiet = False


def tell(text: str, to: TextIO | None = None) -> None:
    """Print how far a sweep is, on standard error unless it goes elsewhere; nothing with ``--quiet``."""
    if not _quiet:
        print(text, file=to or sys.stderr)


def note_sweep(config: DictConfig) -> None:
    """Keep the names of the settings that are swept for the jobs, whose configurations have overrides of their own."""
    global _quiet  # noqa: PLW0603
    _quiet = config.hydra.runtime.choices["hydra/job_logging"] == "silent"  # as `--quiet` has it
    with suppress(OmegaConfBaseException):  # where it is made of what only a job has, such as ${hydra.job.num}
        str(config.hydra.sweep.subdir)


def begin_sweep(config: Any) -> None:
    """Enter a sweep's directory, once no other process is there, leave the configuration in it and show the progress.

    The configuration has its `hydra` node, and its overrides have been found good.

    Raises:
        InputError: The directory is none that a sweep may write into.
    """
    global _running  # noqa: PLW0603
    setting, directory = "hydra.sweep.dir", Path(str(config.hydra.sweep.dir))
    if not config.hydra.sweep.dir:
        raise InputError(setting, config.hydra.sweep.dir, "a directory")
    sweep = Sweep.of(config, directory)
    check_destination(directory, setting)
    stored = directory / STORED
    with writing_into(directory, setting):
        _held.enter_context(held(directory, SWEEP_LOCK))
        early = (*(directory / name for name in _EARLY), *(job / FAILURE for job in job_directories(directory)))
        entries, contents = _entries(directory), {file: content_of(file) for file in early}
        write_text(OmegaConf.to_yaml(config), stored)
        since = stored.stat().st_mtime
    _running = RunningSweep(sweep, entries, contents, since, Progress(sweep, since))


def ended_sweep() -> RunningSweep | None:
    """The sweep that ran, or was cut off, in this process; its progress is shown no more."""
    global _running
    ended, _running = _running, None
    if ended is not None:
        ended.progress.stop()
    return ended


def leave_sweep() -> None:
    """Let others into its directory."""
    _held.close()
