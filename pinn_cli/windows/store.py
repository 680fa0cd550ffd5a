"""What windows leave on the disk, a folder each: all that later ones and the whole need of them.

A window is done when its ``window.json`` is there, which is written last. A run that is killed at any moment finds its
windows there and goes on with the next one, which begins with the very numbers that were handed over to it.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

from pinn_cli.model.file import stored_model, write_model
from pinn_cli.model.knowledge import Model
from pinn_cli.record.windows import Window
from pinn_cli.runs.reading import DamagedError, read_histories, read_json, read_table, stamp
from pinn_cli.runs.writing import tidy, write_json
from pinn_cli.verdict.finding import Word

log = logging.getLogger(__name__)

RESPONSE = "response.nc"
FOLDER, DONE, IDENTITY, HANDED_OVER = "windows", "window.json", "windows.json", "handed_over"
# Of the layout of all that lies there, but for models.
FORMAT = 1


class Stored(TypedDict):
    """What ``windows.json`` says."""

    configuration: str


class _Window(TypedDict):
    number: int
    start: float
    stop: float
    hand_over: float | None
    changed: list[str]
    training: dict[str, Any]
    observed: str
    step: float
    doubts: list[str]


class WindowFile(_Window, total=False):
    """What ``window.json`` says; a verdict where there is one."""

    verdict: Word
    reasons: list[str]


class FirstWindowFile(WindowFile):
    """That of the first says what was prescribed before it too: name, value and standard deviation of parameters."""

    beliefs: list[tuple[str, float | None, float | None]]


@dataclass(frozen=True)
class WindowStore:
    """The windows of the run in a directory.

    Attributes:
        directory: Of the run.
    """

    directory: Path

    def folder(self, number: int) -> Path:
        """Of a window, counted from 1."""
        return self.directory / FOLDER / f"{number:04d}"

    def identity(self) -> str | None:
        """Which run the windows are of; None where there are none.

        Raises:
            InputError: A later release wrote them.
        """
        try:
            return read_json(self.directory / FOLDER / IDENTITY, Stored, FORMAT)["configuration"]
        except (OSError, DamagedError):
            return None

    def begin(self, identity: str, goes_on: bool) -> None:
        """Make room for the windows of a run; those of another one go, and what a killed process left half-written.

        Args:
            identity: Of the run.
            goes_on: Whether it goes on with its own windows.
        """
        place = self.directory / FOLDER
        if not (goes_on and self.identity() == identity):
            shutil.rmtree(place, ignore_errors=True)
            write_json(stamp(FORMAT) | {"configuration": identity}, place / IDENTITY)
        self._forget_damaged()
        for folder in (place, self.folder(self.done + 1)):
            if folder.is_dir():
                tidy(folder)

    @property
    def done(self) -> int:
        """How many windows are done."""
        number = 0
        while (self.folder(number + 1) / DONE).is_file():
            number += 1
        return number

    def conclude(self, window: Window, model: Model | None, content: Mapping[str, object]) -> None:
        """A window is done.

        Args:
            window: Which.
            model: What it hands over; None of the last one.
            content: What is to be known of it.
        """
        folder = self.folder(window.number)
        if model is not None:
            write_model(model, folder / HANDED_OVER)
        times = {"number": window.number, "start": window.start, "stop": window.stop, "hand_over": window.hand_over}
        write_json({**times, **content}, folder / DONE)

    def entry(self, number: int) -> dict[str, Any]:
        """What is known of a window that is done."""
        return dict(read_json(self.folder(number) / DONE, FirstWindowFile if number == 1 else WindowFile))

    def handed_over(self, number: int) -> Model:
        """What a window handed over."""
        return stored_model(self.folder(number) / HANDED_OVER)

    def ends(self, number: int) -> bool:
        """Whether a window that is done was the record's last, so that nothing can go on from it."""
        return self.entry(number)["hand_over"] is None

    def _forget_damaged(self) -> None:
        """Have the first window that is not as it was written be done again, and all that follow it."""
        for number in range(1, self.done + 1):
            try:
                last = self.entry(number)["hand_over"] is None
                for table in self.folder(number).glob("*.csv"):
                    read_table(table)
                with read_histories(self.folder(number) / RESPONSE):
                    pass
                if not last:
                    self.handed_over(number)
            except (OSError, DamagedError) as error:
                log.warning("window %d is solved again: %s", number, error)
                for later in range(self.done, number - 1, -1):
                    self.forget(later)
                return

    def forget(self, number: int) -> None:
        """A window is to be done again."""
        (self.folder(number) / DONE).unlink()
