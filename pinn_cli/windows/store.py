"""What windows leave on the disk, a folder each: all that later ones and the whole need of them.

A window is done when its ``window.json`` is there, which is written last. A run that is killed at any moment finds its
windows there and goes on with the next one, which begins with the very numbers that were handed over to it.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinn_cli.model.file import stored_model, write_model
from pinn_cli.model.model import Model
from pinn_cli.record.windows import Window
from pinn_cli.runs.layout import check_layout, stamp
from pinn_cli.runs.writing import tidy, write_json
from pinn_cli.settings.errors import InputError

FOLDER, DONE, IDENTITY, HANDED_OVER = "windows", "window.json", "windows.json", "handed_over"
# Of the layout of all that lies there, but for models.
FORMAT = 1


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
        file = self.directory / FOLDER / IDENTITY
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
            configuration = str(found["configuration"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        check_layout(found, FORMAT, file)
        return configuration

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
        content = json.loads((self.folder(number) / DONE).read_text(encoding="utf-8"))
        if not isinstance(content, dict):
            raise InputError("hydra.run.dir", self.directory, "a run whose windows are as it wrote them", f"{DONE}?")
        return content

    def handed_over(self, number: int) -> Model:
        """What a window handed over."""
        return stored_model(self.folder(number) / HANDED_OVER)

    def ends(self, number: int) -> bool:
        """Whether a window that is done was the record's last, so that nothing can go on from it."""
        return self.entry(number)["hand_over"] is None

    def forget(self, number: int) -> None:
        """A window is to be done again."""
        (self.folder(number) / DONE).unlink()
