"""What windows leave on the disk, a folder each, and the whole of a record from them.

A window is done when its ``window.json`` is there, which is written last. A run that is killed at any moment finds its
windows there and goes on with the next one, which begins with the very numbers that were handed over to it. They are
joined a window at a time: memory does not grow with a measured record.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import h5netcdf
import h5py
import numpy as np
import pandas as pd

from pinn_cli.model.file import stored_model, write_model
from pinn_cli.model.knowledge import Model
from pinn_cli.record.response import QUANTITIES
from pinn_cli.record.windows import Window
from pinn_cli.report.fitness import both_formulas, fitness_rows
from pinn_cli.report.results import with_labels
from pinn_cli.runs.histories import Group, Labelled, read_groups
from pinn_cli.runs.reading import DamagedError, read_json, read_table, stamp
from pinn_cli.runs.writing import replacing_by_large, tidy, write_json, write_text
from pinn_cli.verdict.finding import Word

log = logging.getLogger(__name__)

RESPONSE, TIME = "response.nc", "time"
FOLDER, DONE, IDENTITY, HANDED_OVER = "windows", "window.json", "windows.json", "handed_over"
# Of the layout of all that lies there, but for models.
FORMAT = 1
# Bytes at most of names, attributes and HDF5's own tables.
AROUND_DATA = 2**20


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
    """The windows of the run in a directory."""

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
        """Make room for the windows of a run; those of another one go, and what a killed process left half-written."""
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
        """A window is done: what it hands over, None of the last one, and what is to be known of it."""
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
        responses = read_groups([self.folder(number) / RESPONSE for number in range(1, self.done + 1)])
        for number in range(1, self.done + 1):
            try:
                last = self.entry(number)["hand_over"] is None
                for table in self.folder(number).glob("*.csv"):
                    read_table(table)
                next(responses)
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


class Piece(NamedTuple):
    """A window's part of the whole record: its folder, and where the next one's begins.

    ``until`` is the time of the first sample that is the next window's, s, None of the last; samples are ``step`` s
    apart.
    """

    folder: Path
    until: float | None
    step: float

    def samples(self, time: np.ndarray) -> int:
        """How many of the window's samples, whose times these are, are its own."""
        return len(time) if self.until is None else int(np.searchsorted(time, self.until - 0.5 * self.step))


def join_responses(pieces: Sequence[Piece], target: Path) -> None:
    """Write ``response.nc`` of the whole record: every window up to where it handed over, the last one to its end.

    A history that some windows have and others have not is NaN where it is missing.

    Raises:
        DamagedError: The file of a window cannot be read.
    """
    files = [piece.folder / RESPONSE for piece in pieces]
    counts: list[int] = []
    sources: dict[str, Labelled] = {}  # of the last window that has it; of histories no sample
    last = Group({}, {})
    for piece, read in zip(pieces, read_groups(files), strict=True):
        last = read["/"]
        counts.append(piece.samples(last.arrays[TIME].values))
        for name, array in last.arrays.items():
            sources[name] = array._replace(values=array.values[:0].copy()) if _is_history(array) else array
    # Those of the last window come first, in its order.
    sources = {name: sources[name] for name in (*last.arrays, *(n for n in sources if n not in last.arrays))}
    width = sum(int(np.prod(array.values.shape[1:])) for array in sources.values() if _is_history(array))
    with (
        replacing_by_large(target, 2 * 8 * sum(counts) * width + AROUND_DATA) as place,
        h5netcdf.File(place, "w", locking=False) as whole,
    ):
        sizes = {name: size for array in last.arrays.values() for name, size in array.sizes.items()}
        whole.dimensions = sizes | {TIME: sum(counts)}
        whole.attrs.update(last.attributes)
        for name, array in sources.items():
            values, of_texts = array.values, array.values.dtype.kind == "U"
            kind = h5py.string_dtype() if of_texts else values.dtype
            data = None if _is_history(array) else values.astype(object) if of_texts else values
            fill = {"fillvalue": np.nan} if data is None and values.dtype.kind == "f" and name != TIME else {}
            made = whole.create_variable(name, array.dims, kind, data=data, **fill)
            made.attrs.update({key: value for key, value in array.attributes.items() if key != "_FillValue"})
        first = 0
        for read, count in zip(read_groups(files), counts, strict=True):
            for name, array in read["/"].arrays.items():
                if _is_history(array):
                    whole[name][first : first + count] = array.values[:count]
            first += count


def _is_history(array: Labelled) -> bool:
    return array.dims[:1] == (TIME,)


def joined_fitness(response: Path, labels: Mapping[str, object]) -> pd.DataFrame:
    """The content of ``fitness.csv`` over the whole record, after leading columns, of what `join_responses` wrote.

    A quantity is read as a whole where its truth is known.
    """
    with h5netcdf.File(response, "r") as file:
        observed = np.asarray(file["observed"][...]).astype(bool)
        scores = dict.fromkeys(QUANTITIES, np.full((2, len(observed)), np.nan))
        for quantity in QUANTITIES:
            if f"{quantity}_true" in file.variables:
                estimate, truth = (np.asarray(file[name][...]) for name in (quantity, f"{quantity}_true"))
                scores[quantity] = both_formulas(estimate, truth)
    return with_labels(fitness_rows(scores, observed), labels)


def stack_tables(files: Sequence[Path], target: Path, column: str | None = None) -> None:
    """Write the rows of tables one below the other, digit by digit as they are.

    Args:
        files: Tables with the same columns, of the windows in their order; one that does not exist has no rows.
        target: Of the whole.
        column: Name of a leading column with the window's number; None: there is none.
    """
    lines: list[str] = []
    for number, file in enumerate(files, start=1):
        if file.is_file():
            head, *rows = file.read_text(encoding="utf-8").splitlines()
            lines += [] if lines else [head if column is None else f"{column},{head}"]
            lines += rows if column is None else [f"{number},{row}" for row in rows]
    if lines:
        write_text("\n".join(lines), target)
