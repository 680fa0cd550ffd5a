"""The whole of a record from its windows, a window at a time: memory does not grow with the record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5netcdf
import numpy as np
import pandas as pd

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.fitness import fitness_rows
from pinn_cli.report.results import with_labels
from pinn_cli.runs.writing import replacing_by_large, write_text

RESPONSE, TIME = "response.nc", "time"
# Bytes at most of names, attributes and HDF5's own tables.
AROUND_DATA = 2**20

Parts = Callable[[], Iterator[tuple[np.ndarray, np.ndarray]]]


@dataclass(frozen=True)
class Piece:
    """A window's part of the whole record.

    Attributes:
        folder: Of the window.
        until: Time of the first sample that is the next window's, s; None of the last.
        step: From sample to sample, s.
    """

    folder: Path
    until: float | None
    step: float

    def samples(self) -> int:
        """How many of the window's samples are its own."""
        with h5netcdf.File(self.folder / RESPONSE, "r") as file:
            time = np.asarray(file[TIME][...])
        return len(time) if self.until is None else int(np.searchsorted(time, self.until - 0.5 * self.step))


def join_responses(pieces: Sequence[Piece], target: Path) -> None:
    """Write ``response.nc`` of the whole record: every window up to where it handed over, the last one to its end.

    A history that some windows have and others have not is NaN where it is missing.
    """
    counts = [piece.samples() for piece in pieces]
    like = _variables(pieces)
    size = sum(counts) * sum(8 * own.width for own in like.values() if own.over_time)
    last = pieces[-1].folder / RESPONSE
    with (
        replacing_by_large(target, 2 * size + AROUND_DATA) as place,
        h5netcdf.File(place, "w", locking=False) as out,
        h5netcdf.File(last, "r") as model,
    ):
        out.dimensions = {name: sum(counts) if name == TIME else len(d) for name, d in model.dimensions.items()}
        for name, value in model.attrs.items():
            out.attrs[name] = value
        for name, own in like.items():
            with h5netcdf.File(own.source, "r") as source:
                there = source[name]
                data = None if own.over_time else there[...]
                fill = {"fillvalue": np.nan} if own.over_time and there.dtype.kind == "f" and name != TIME else {}
                made = out.create_variable(name, there.dimensions, there.dtype, data=data, **fill)
                for key, value in there.attrs.items():
                    if key != "_FillValue":
                        made.attrs[key] = value
        first = 0
        for piece, count in zip(pieces, counts, strict=True):
            with h5netcdf.File(piece.folder / RESPONSE, "r") as source:
                for name, own in like.items():
                    if own.over_time and name in source.variables:
                        out[name][first : first + count] = source[name][:count]
            first += count


@dataclass(frozen=True)
class _Variable:
    """One that a window has.

    Attributes:
        source: A file that has it.
        over_time: Whether it is a history.
        width: Numbers at a time.
    """

    source: Path
    over_time: bool
    width: int


def _variables(pieces: Sequence[Piece]) -> dict[str, _Variable]:
    """Name to each that any window has, those of the last window first."""
    found: dict[str, _Variable] = {}
    for piece in reversed(pieces):
        path = piece.folder / RESPONSE
        with h5netcdf.File(path, "r") as file:
            for name, variable in file.variables.items():
                if name not in found:
                    over_time = variable.dimensions[:1] == (TIME,)
                    found[name] = _Variable(path, over_time, int(np.prod(variable.shape[1:])))
    return found


def joined_fitness(pieces: Sequence[Piece], labels: Mapping[str, object]) -> pd.DataFrame:
    """The content of ``fitness.csv`` over the whole record.

    Args:
        pieces: Of the record.
        labels: The leading columns.
    """
    counts = [piece.samples() for piece in pieces]
    scores = {}
    for quantity in QUANTITIES:

        def parts(quantity: str = quantity) -> Iterator[tuple[np.ndarray, np.ndarray]]:
            for piece, count in zip(pieces, counts, strict=True):
                with h5netcdf.File(piece.folder / RESPONSE, "r") as file:
                    estimate = np.asarray(file[quantity][:count])
                    true = f"{quantity}_true"
                    yield estimate, np.asarray(file[true][:count]) if true in file.variables else estimate * np.nan

        scores[quantity] = scores_of_parts(parts)
    with h5netcdf.File(pieces[-1].folder / RESPONSE, "r") as file:
        observed = np.asarray(file["observed"][...]).astype(bool)
    return with_labels(fitness_rows(scores, observed), labels)


def scores_of_parts(parts: Parts) -> np.ndarray:
    """Both formulas of :func:`pinn_cli.report.fitness.both_formulas`, (2, dof), of histories that come in parts.

    Args:
        parts: Gives estimate and truth, (time, dof) each, part by part; it is called twice.
    """
    total: np.ndarray | float = 0.0
    count: np.ndarray | float = 0.0
    low: np.ndarray | float = np.inf
    high: np.ndarray | float = -np.inf
    for _, truth in parts():
        known = np.isfinite(truth)
        total = total + np.where(known, truth, 0.0).sum(axis=0)
        count = count + known.sum(axis=0)
        low = np.minimum(low, np.min(truth, axis=0, initial=np.inf, where=known))
        high = np.maximum(high, np.max(truth, axis=0, initial=-np.inf, where=known))
    mean = total / np.maximum(count, 1.0)
    error: np.ndarray | float = 0.0
    deviation: np.ndarray | float = 0.0
    for estimate, truth in parts():
        known = np.isfinite(truth)
        error = error + (np.where(known, estimate - truth, 0.0) ** 2).sum(axis=0)
        deviation = deviation + (np.where(known, truth - mean, 0.0) ** 2).sum(axis=0)
    span = np.asarray(high) - np.asarray(low)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.sqrt(np.asarray(error) / np.asarray(deviation))
        rmse = np.sqrt(np.asarray(error) / np.maximum(count, 1.0))
        return np.where(span > 0.0, 100.0 * (1.0 - np.stack([ratio, rmse / span])), np.nan)


def stack_tables(files: Sequence[Path], target: Path, column: str | None = None) -> None:
    """Write the rows of tables one below the other, digit by digit as they are.

    Args:
        files: Tables with the same columns, of the windows in their order; one that does not exist has no rows.
        target: Of the whole.
        column: Name of a leading column with the window's number; None: there is none.
    """
    lines: list[str] = []
    for number, file in enumerate(files, start=1):
        if not file.is_file():
            continue
        head, *rows = file.read_text(encoding="utf-8").splitlines()
        before = ("", "") if column is None else (f"{column},", f"{number},")
        lines += [before[0] + head] if not lines else []
        lines += [before[1] + row for row in rows]
    if lines:
        write_text("\n".join(lines), target)
