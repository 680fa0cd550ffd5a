"""A run's directory is checked, then locked, then written to: a command that is refused or waits changes nothing in it.

A run, or a sweep, writes only where nothing lies, or where `pinn-run` has written before. Hydra only makes the
directory. The settings (`.hydra/`) and the log are written here, once the run's input has been found good and no other
process is at work there. What a refused run has replaced is put back. Nothing slow is imported here.

The operating system holds a lock for an open file and gives it back when the process ends, however it ends, so that
nothing is left over from a kill. Between machines it holds where the file system's locks do: NFS, GPFS, Lustre mounted
with `flock`. Where a file system has none, the run says so and goes on without.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import shutil
import socket
import stat
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from logging.handlers import MemoryHandler
from pathlib import Path

from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.runs.reading import printable, small_text
from pinn_cli.runs.writing import WriteError, content_of, put_back, replacing, tidy
from pinn_cli.settings.errors import InputError

LOG, LOG_FORMAT = "pinn-run.log", "[%(asctime)s][%(name)s][%(levelname)s] %(message)s"
SETTINGS = ".hydra"
# Of a run and of a sweep, whose directory a job may have for its own; seconds from one look there to the next.
LOCK, SWEEP_LOCK, EVERY_S = "run.lock", "sweep.lock", 1.0
# What a file system without locks answers.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)
# The files of a run's and of a sweep's directory that carry the mark: the name of the package, among Hydra's settings.
MARKED, MARK_OF_OURS = (f"{SETTINGS}/hydra.yaml", "multirun.yaml"), "pinn_cli"
# What may lie in a directory that was prepared and never begun: by pattern, with files that were being written.
_PREPARED = re.compile(r"(run|sweep)\.lock|failure\.json|\.submitit|\.(failure|multirun)\.\d+\.partial\.(json|yaml)")
_PREPARED_SETTINGS = re.compile(r"overrides\.yaml|\.(hydra|config|overrides)\.\d+\.partial\.yaml")
_FILES = re.compile(r".*\.(csv|db|json|pt|nc|log|lock|yaml)")
_FOLDERS = (SETTINGS, "figures", "chains", "tensorboard")
DIRECTORIES_ALLOWED = "a new or empty directory, or one that pinn-run made"

log = logging.getLogger(__name__)


def check_destination(directory: Path, setting: str) -> None:
    """See to it that a run, or a sweep, may write into a directory, which is made where it is missing.

    Raises:
        InputError: Naming the setting that named it: it cannot be made, or holds files that are not of `pinn-run`, or
            something else in the place of one.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        entries = sorted(directory.iterdir())
    except OSError as error:
        raise InputError(setting, directory, "a directory that can be made", error.strerror or str(error)) from error
    if not any(_carries_mark(directory / name) for name in MARKED):
        foreign = [entry.name for entry in entries if not is_prepared(entry)]
        if foreign:
            named = ", ".join(foreign[:3]) + (", ..." if len(foreign) > 3 else "")
            hint = f"files of yours might be replaced there ({named}): name another directory"
            raise InputError(setting, directory, DIRECTORIES_ALLOWED, hint)
    settings = directory / SETTINGS
    for entry in [*entries, *(sorted(settings.iterdir()) if settings.is_dir() else ())]:
        # Where a run would write a file there must be a file or nothing: no folder, FIFO or link to another place.
        kind = entry.lstat().st_mode
        if entry.name in _FOLDERS and not stat.S_ISDIR(kind):
            raise InputError(setting, entry.parent, DIRECTORIES_ALLOWED, f"{entry.name} there is no directory")
        if _FILES.fullmatch(entry.name) and not stat.S_ISREG(kind):
            raise InputError(setting, entry.parent, DIRECTORIES_ALLOWED, f"{entry.name} there is no regular file")


@contextmanager
def writing_into(directory: Path, setting: str) -> Iterator[None]:
    """Refuse a directory that the disk takes no file into, as the block finds out."""
    try:
        yield
    except (OSError, WriteError) as error:
        said = getattr(error, "reason", "") or getattr(error, "strerror", "") or str(error)
        raise InputError(setting, directory, "a directory that can be written to", said) from error


def _carries_mark(file: Path) -> bool:
    try:
        return MARK_OF_OURS in small_text(file)
    except OSError:
        return False


def is_prepared(entry: Path) -> bool:
    """Whether an entry of a directory is one that a run, or a job, leaves before it has begun."""
    if entry.name == SETTINGS and entry.is_dir():
        return all(_PREPARED_SETTINGS.fullmatch(inner.name) for inner in entry.iterdir())
    return _PREPARED.fullmatch(entry.name) is not None


@contextmanager
def held(directory: Path, name: str = LOCK) -> Iterator[None]:
    """Keep other processes out of a run's or a sweep's directory during the block, once those before have left it.

    The file of this name in it says who is in there while the block runs.
    """
    with locked(directory / name, f"waiting for another process to leave {directory}", EVERY_S):
        yield


@contextmanager
def if_free(directory: Path) -> Iterator[bool]:
    """Whether no other process is in a run's or a sweep's directory, or comes in meanwhile: see :func:`held`."""
    from filelock import FileLock, Timeout

    with ExitStack() as locks:
        try:
            for name in (LOCK, SWEEP_LOCK):
                locks.enter_context(FileLock(directory / name, blocking=False, fallback_to_soft=False))
            free = True
        except Timeout:
            free = False
        except OSError:  # a file system without locks
            free = True
        yield free


@contextmanager
def locked(file: Path, waiting: str = "", every_s: float = 0.1) -> Iterator[None]:
    """Have one process at a time in the block, of those that name the same file.

    Args:
        file: Made where it is missing, and removed at the end; its folder exists. While the block runs it says whose.
        waiting: What the log is told where the process has to wait; empty: nothing.
        every_s: Seconds from one look to the next.
    """
    from filelock import FileLock, Timeout  # not for --help

    # No marker in place of a lock, which a kill would leave behind.
    lock = FileLock(file, thread_local=False, fallback_to_soft=False)
    try:
        try:
            lock.acquire(blocking=False)
        except Timeout:
            if waiting:
                owner = ""  # as it wrote it: for a person to read, and nothing depends on it
                with suppress(OSError):  # it has left meanwhile
                    owner = small_text(file)
                log.warning("%s: %s", waiting, owner or "one that has just begun")
            while not lock.is_locked:
                with suppress(FileNotFoundError):  # who was in there took the folder along: it is made anew
                    lock.acquire(poll_interval=every_s)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        file.unlink(missing_ok=True)
        log.warning("%s is on a file system without locks: have no two processes write there", file.parent)
    try:
        if lock.is_locked:
            job = {"slurm_job": os.environ["SLURM_JOB_ID"]} if "SLURM_JOB_ID" in os.environ else {}
            with suppress(OSError):  # on a full disk nobody learns who is in there
                file.write_text(json.dumps({"host": socket.gethostname(), "pid": os.getpid(), **job}), encoding="utf-8")
        yield
    finally:
        if lock.is_locked:
            with suppress(OSError):  # while it is locked: whoever has opened it meanwhile finds out and opens a new one
                file.unlink()
            lock.release()


# Directories that did not exist before the run or sweep that was started last, its own first.
_new: list[Path] = []


def note_new(directory: Path) -> None:
    """Note the directory of a run or of a sweep, and its parents, as far as they are missing: see :func:`discard`."""
    path = directory.absolute()
    _new[:] = [p for p in (path, *path.parents) if not os.path.lexists(p)]


def discard() -> None:
    """Remove what unusable input left: directories that are new, and in which nobody is nor any run was begun."""
    for directory in _new[:1]:
        if _is_unused(directory):
            with if_free(directory) as free:
                if free and _is_unused(directory):
                    shutil.rmtree(directory)
    for directory in _new[1:]:
        with suppress(OSError):  # it holds something, or was not made
            directory.rmdir()


def _is_unused(directory: Path) -> bool:
    # `Path.is_dir` raises where a name is too long
    return os.path.isdir(directory) and all(map(is_prepared, directory.iterdir()))


class RunLog(MemoryHandler):
    """`pinn-run.log`: what is said before the directory is the run's own waits in memory."""

    def __init__(self) -> None:
        super().__init__(sys.maxsize, logging.CRITICAL + 1)

    def attach(self) -> None:
        """Have everything that this process logs come here too, and control characters in it be written out."""
        logging.getLogger().addHandler(self)
        for handler in logging.getLogger().handlers:
            handler.addFilter(_write_out)

    def open(self, path: Path) -> None:
        """Append what waits, and from now on every line.

        Raises:
            OSError: The file cannot be opened.
        """
        file = logging.FileHandler(path, encoding="utf-8")
        file.handleError = lambda record: None  # type: ignore[method-assign]  # a full disk ends no run
        file.setFormatter(logging.Formatter(LOG_FORMAT))
        self.setTarget(file)
        self.flushLevel = logging.NOTSET
        self.flush()

    def close(self) -> None:
        """Close the file and hear no more."""
        for handler in logging.getLogger().handlers:
            handler.removeFilter(_write_out)
        logging.getLogger().removeHandler(self)
        file = self.target
        super().close()
        if file is not None:
            with suppress(OSError):
                file.close()


def _write_out(record: logging.LogRecord) -> bool:
    with suppress(Exception):  # a text that its arguments do not fit: each handler says so
        record.msg, record.args = printable(record.getMessage()), None
    return True


class Claim:
    """The directory of the run that this process is about to make.

    Args:
        directory: Of the run; absolute, made by Hydra.
        setting: Name of the setting that named it.
        settings: What `.hydra/` is to hold, by file; empty for a run that goes on with those that lie there.

    Attributes:
        locked, taken: Whether :meth:`lock` and :meth:`take` were called.
        untouched: There is nothing to do here, and the directory is to stay as it is.
    """

    def __init__(self, directory: Path, setting: str, settings: Mapping[str, DictConfig | ListConfig]) -> None:
        self.directory, self.setting, self.settings = directory, setting, settings
        self.log = RunLog()
        self.taken = self.untouched = self.locked = False
        self._held = ExitStack()
        self._before: dict[Path, bytes | None] = {}
        self._aside: dict[Path, Path] = {}

    def lock(self) -> None:
        """Wait until no other process is at work in the directory, and keep others out from then on.

        Raises:
            InputError: The directory is none that a run may write into.
        """
        if self.locked:
            return
        check_destination(self.directory, self.setting)
        with writing_into(self.directory, self.setting):
            self._held.enter_context(held(self.directory))
        self.locked = True

    def take(self, outdated: Iterable[str] = ()) -> None:
        """Write the settings and begin the log; what a killed run left half-written goes.

        Args:
            outdated: Names of files of an earlier run, which are of no use to this one: see :meth:`settle`.

        Raises:
            InputError: The directory is none that a run may write into, or the disk refuses.
        """
        if self.taken or self.untouched:
            return
        self.lock()
        written = {self.directory / SETTINGS / name: content for name, content in self.settings.items()}
        try:
            with writing_into(self.directory, self.setting):
                tidy(self.directory)
                self._before = {place: content_of(place) for place in (*written, self.directory / LOG)}
                with ExitStack() as files:  # all, or none: the mark of the directory is there at any moment
                    for place, content in written.items():
                        temporary = files.enter_context(replacing(place))
                        temporary.write_text(OmegaConf.to_yaml(content), encoding="utf-8")
                for place in (self.directory / name for name in outdated):
                    if place.is_file():
                        # As a file that is being written: should the process be killed, :func:`tidy` removes it.
                        aside = place.with_name(f".{place.stem}.before.{os.getpid()}.partial{place.suffix}")
                        os.replace(place, aside)
                        self._aside[place] = aside
                self.log.open(self.directory / LOG)
        except BaseException:
            self.refuse()
            raise
        self.taken = True

    def settle(self) -> None:
        """Remove what was set aside: the input has stood every test, and nothing leads back to the earlier run."""
        for place in self._aside.values():
            with suppress(OSError):
                place.unlink(missing_ok=True)
        self._aside.clear()

    def refuse(self) -> None:
        """Put everything back as it was before the directory was taken, if it was."""
        self.log.close()
        for place, content in self._before.items():
            with suppress(WriteError):
                put_back(place, content)
        self._before.clear()
        for place, aside in self._aside.items():
            os.replace(aside, place)
        self._aside.clear()
        with suppress(OSError):  # it holds something, or was not made
            (self.directory / SETTINGS).rmdir()

    def release(self) -> None:
        """Let others in."""
        self.settle()
        self.log.close()
        self._held.close()


# Of this process, which makes one run at a time.
_claims: list[Claim] = []


@contextmanager
def entered(claim: Claim) -> Iterator[None]:
    """Make a run in the block, whose claim is :func:`current` meanwhile."""
    _claims.append(claim)
    claim.log.attach()
    try:
        yield
    finally:
        _claims.remove(claim)
        claim.release()


def current() -> Claim:
    """Of the run that is being made in this process."""
    return _claims[-1]
