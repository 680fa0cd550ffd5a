"""The whole of a record from its windows, a window at a time: memory does not grow with the record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import h5netcdf
import numpy as np
import pandas as pd

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.fitness import fitness_rows
from pinn_cli.report.results import with_labels
from pinn_cli.runs.writing import replacing_by_large, write_text

RESPONSE, TIME = "response.nc", "time"
# Samples that are held in memory.
AT_ONCE = 2**16
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
    # Name to a file that has it: those of the last window first, with its attributes.
    sources: dict[str, Path] = {}
    width = 0
    for piece in reversed(pieces):
        with h5netcdf.File(piece.folder / RESPONSE, "r") as file:
            for name, variable in file.variables.items():
                if name not in sources:
                    sources[name] = piece.folder / RESPONSE
                    width += int(np.prod(variable.shape[1:])) if variable.dimensions[:1] == (TIME,) else 0
    with (
        replacing_by_large(target, 2 * 8 * sum(counts) * width + AROUND_DATA) as place,
        h5netcdf.File(place, "w", locking=False) as out,
        h5netcdf.File(pieces[-1].folder / RESPONSE, "r") as model,
    ):
        out.dimensions = {name: sum(counts) if name == TIME else len(d) for name, d in model.dimensions.items()}
        for name, value in model.attrs.items():
            out.attrs[name] = value
        for name, source in sources.items():
            with h5netcdf.File(source, "r") as file:
                there = file[name]
                over_time = there.dimensions[:1] == (TIME,)
                data = None if over_time else there[...]
                fill = {"fillvalue": np.nan} if over_time and there.dtype.kind == "f" and name != TIME else {}
                made = out.create_variable(name, there.dimensions, there.dtype, data=data, **fill)
                for key, value in there.attrs.items():
                    if key != "_FillValue":
                        made.attrs[key] = value
        first = 0
        for piece, count in zip(pieces, counts, strict=True):
            with h5netcdf.File(piece.folder / RESPONSE, "r") as file:
                for name, variable in file.variables.items():
                    if variable.dimensions[:1] == (TIME,):
                        out[name][first : first + count] = variable[:count]
            first += count


def joined_fitness(response: Path, labels: Mapping[str, object]) -> pd.DataFrame:
    """The content of ``fitness.csv`` over the whole record.

    Args:
        response: The file that :func:`join_responses` wrote.
        labels: The leading columns.
    """
    with h5netcdf.File(response, "r") as file:
        scores = {quantity: scores_of_parts(partial(_parts, file, quantity)) for quantity in QUANTITIES}
        observed = np.asarray(file["observed"][...]).astype(bool)
    return with_labels(fitness_rows(scores, observed), labels)


def _parts(file: h5netcdf.File, quantity: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Estimate and truth, which is NaN where nobody knows it, some samples at a time."""
    name = f"{quantity}_true"
    for first in range(0, file[TIME].shape[0], AT_ONCE):
        estimate = np.asarray(file[quantity][first : first + AT_ONCE])
        known = name in file.variables
        yield estimate, np.asarray(file[name][first : first + AT_ONCE]) if known else estimate * np.nan


def scores_of_parts(parts: Parts) -> np.ndarray:
    """Both formulas of :func:`pinn_cli.report.fitness.both_formulas`, (2, dof), of histories that come in parts.

    Args:
        parts: Gives estimate and truth, (time, dof) each, part by part; it is called twice.
    """
    total, count, low, high = 0.0, 0.0, np.inf, -np.inf
    for _, truth in parts():
        known = np.isfinite(truth)
        total = total + np.where(known, truth, 0.0).sum(axis=0)
        count = count + known.sum(axis=0)
        low = np.minimum(low, np.min(truth, axis=0, initial=np.inf, where=known))
        high = np.maximum(high, np.max(truth, axis=0, initial=-np.inf, where=known))
    mean, error, deviation = total / np.maximum(count, 1.0), 0.0, 0.0
    for estimate, truth in parts():
        known = np.isfinite(truth)
        error = error + (np.where(known, estimate - truth, 0.0) ** 2).sum(axis=0)
        deviation = deviation + (np.where(known, truth - mean, 0.0) ** 2).sum(axis=0)
    span = high - low
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio, rmse = np.sqrt(np.divide(error, deviation)), np.sqrt(error / np.maximum(count, 1.0))
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
