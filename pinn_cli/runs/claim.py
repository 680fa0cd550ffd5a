"""A run's directory is checked, then locked, then written to: a command that is refused or waits changes nothing in it.

Hydra only makes the directory. The settings (`.hydra/`) and the log are written here, once the run's input has been
found good and no other process is at work there. Nothing slow is imported here.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from logging.handlers import MemoryHandler
from pathlib import Path

from omegaconf import DictConfig, ListConfig, OmegaConf

from pinn_cli.runs.lock import held
from pinn_cli.runs.ownership import SETTINGS, check_destination, made
from pinn_cli.runs.reading import printable
from pinn_cli.runs.writing import WriteError, content_of, put_back, replacing, tidy
from pinn_cli.settings.errors import InputError

LOG, FORMAT = "pinn-run.log", "[%(asctime)s][%(name)s][%(levelname)s] %(message)s"

log = logging.getLogger(__name__)


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
        file = _LogFile(path, encoding="utf-8")
        file.setFormatter(logging.Formatter(FORMAT))
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


class _LogFile(logging.FileHandler):
    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """A disk that takes no more ends no run: the line is lost."""


class Claim:
    """The directory of the run that this process is about to make.

    Args:
        directory: Of the run; absolute, made by Hydra.
        setting: Name of the setting that named it.
        settings: What `.hydra/` is to hold, by file; empty for a run that goes on with those that lie there.
    """

    def __init__(self, directory: Path, setting: str, settings: Mapping[str, DictConfig | ListConfig]) -> None:
        self.directory, self.setting, self.settings = directory, setting, settings
        self.log = RunLog()
        self.taken = self.left = self.locked = False
        self._held = ExitStack()
        self._aside: dict[Path, Path] = {}
        self._replaced: dict[Path, bytes | None] = {}
        self._logged: int | None = None

    def lock(self) -> None:
        """Wait until no other process is at work in the directory, and keep others out from then on.

        Raises:
            InputError: The directory is none that a run may write into.
        """
        if self.locked:
            return
        check_destination(made(self.directory, self.setting), self.setting)
        with self._one_line():
            self._held.enter_context(held(self.directory))
        self.locked = True

    def take(self, outdated: Iterable[str] = ()) -> None:
        """Write the settings and begin the log; what a killed run left half-written goes.

        Args:
            outdated: Names of files of an earlier run, which are of no use to this one: see :meth:`settle`.

        Raises:
            InputError: The directory is none that a run may write into, or the disk refuses.
        """
        if self.taken or self.left:
            return
        self.lock()
        try:
            with self._one_line():
                tidy(self.directory)
                self._write_settings()
                for name in outdated:
                    self._set_aside(self.directory / name)
                self._begin_log()
        except BaseException:
            self.refuse()
            raise
        self.taken = True

    def leave(self) -> None:
        """There is nothing to do here: the directory stays as it is."""
        self.left = True

    def settle(self) -> None:
        """Remove what was set aside: the input has stood every test, and nothing leads back to the earlier run."""
        for place in self._aside.values():
            with suppress(OSError):
                place.unlink(missing_ok=True)
        self._aside.clear()

    def refuse(self) -> None:
        """Put everything back as it was before the directory was taken, if it was."""
        for place, content in self._replaced.items():
            put_back(place, content)
        self._replaced.clear()
        for place, aside in self._aside.items():
            os.replace(aside, place)
        self._aside.clear()
        self.log.close()
        if self._logged is not None:
            _cut(self.directory / LOG, self._logged)
        with suppress(OSError):  # it holds something, or was not made
            (self.directory / SETTINGS).rmdir()

    def release(self) -> None:
        """Let others in."""
        self.settle()
        self.log.close()
        self._held.close()

    def _set_aside(self, place: Path) -> None:
        """A name as of a file that is being written: should the process be killed, :func:`tidy` removes it."""
        if place.is_file():
            aside = place.with_name(f".{place.stem}.before.{os.getpid()}.partial{place.suffix}")
            os.replace(place, aside)
            self._aside[place] = aside

    def _write_settings(self) -> None:
        """All of its files, or none; the mark of the directory is among them, and is there at any moment."""
        places = {self.directory / SETTINGS / name: content for name, content in self.settings.items()}
        before = {place: content_of(place) for place in places}
        with ExitStack() as files:
            for place, content in places.items():
                files.enter_context(replacing(place)).write_text(OmegaConf.to_yaml(content), encoding="utf-8")
            self._replaced = before

    def _begin_log(self) -> None:
        place = self.directory / LOG
        self._logged = place.stat().st_size if place.exists() else 0
        self.log.open(place)

    @contextmanager
    def _one_line(self) -> Iterator[None]:
        try:
            yield
        except (OSError, WriteError) as error:
            raise InputError(
                self.setting, self.directory, "a directory that can be written to", reason(error)
            ) from error


def _cut(file: Path, size: int) -> None:
    with suppress(OSError):
        if size:
            os.truncate(file, size)
        else:
            file.unlink(missing_ok=True)


def reason(error: BaseException) -> str:
    """What the system says, without the number of the error."""
    if isinstance(error, WriteError):
        return error.reason
    return error.strerror if isinstance(error, OSError) and error.strerror else str(error)


# Of this process, which makes one run at a time.
_current: Claim | None = None


@contextmanager
def entered(claim: Claim) -> Iterator[None]:
    """Make a run in the block, which :func:`lock_directory` and its like are then about."""
    global _current  # noqa: PLW0603
    _current = claim
    claim.log.attach()
    try:
        yield
    finally:
        _current = None
        claim.release()


def lock_directory() -> None:
    """:meth:`Claim.lock` of the run that is being made in this process, if it is made by the command."""
    if _current is not None:
        _current.lock()


def take_directory(outdated: Iterable[str] = ()) -> None:
    """:meth:`Claim.take` of the run that is being made in this process, if it is made by the command."""
    if _current is not None:
        _current.take(outdated)


def leave_directory() -> None:
    """:meth:`Claim.leave` of the run that is being made in this process, if it is made by the command."""
    if _current is not None:
        _current.leave()


def settle_directory() -> None:
    """:meth:`Claim.settle` of the run that is being made in this process, if it is made by the command."""
    if _current is not None:
        _current.settle()
