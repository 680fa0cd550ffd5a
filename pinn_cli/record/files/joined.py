"""Columns that were sampled at different times on one clock, in one table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.record.files.table import Table
from pinn_cli.settings.errors import InputError

# Times that differ by less than this part of the shortest step are the same.
SAME_TIME = 0.01


def joined(tables: Sequence[Table], times: Sequence[np.ndarray], without: Sequence[str] = ()) -> Table:
    """One table over all the times that there are; a column is NaN at times that it has no sample of.

    Args:
        tables: Their columns have different names.
        times: Of each table's samples, (N,), s, increasing, on the same clock.
        without: Columns that are left out: those of the times.

    Returns:
        With ``time``, and ``sources``.

    Raises:
        InputError: The clocks do not overlap, or two tables have a column of the same name.
    """
    _check_overlap(tables, times)
    time, places = _union(times)
    columns: dict[str, np.ndarray] = {}
    sources: dict[str, tuple[Table, np.ndarray]] = {}
    odd: dict[str, dict[int, str]] = {}
    for table, here in zip(tables, places, strict=True):
        rows = np.full(len(time), -1)
        rows[here] = np.arange(len(here))
        for name in (name for name in table.columns if name not in without):
            if name in columns:
                shown = f"{sources[name][0].path.name}, {table.path.name}"
                raise InputError("data.path", shown, "files whose columns have different names", f"{name!r} is in both")
            columns[name] = np.where(rows >= 0, table.columns[name][rows], np.nan)
            odd[name] = {int(here[row]): text for row, text in table.odd_cells.get(name, {}).items()}
            sources[name] = table, rows
    hints = {name: hint for table in tables for name, hint in table.hints.items()}
    return Table(tables[0].path, columns, odd, hints, time, sources=sources)


def _union(times: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """All times, those that are the same once; and of each sequence the place of every time in it."""
    every = np.concatenate(times)
    order = np.argsort(every, kind="stable")
    shortest = min(float(np.median(np.diff(time))) for time in times if len(time) > 1)
    new = np.concatenate(([True], np.diff(every[order]) > SAME_TIME * shortest))
    place = np.empty(len(every), dtype=int)
    place[order] = np.cumsum(new) - 1
    ends = np.cumsum([len(time) for time in times])[:-1]
    return every[order][new], np.split(place, ends)


def _check_overlap(tables: Sequence[Table], times: Sequence[np.ndarray]) -> None:
    for table, time in zip(tables, times, strict=True):
        if len(time) < 2:
            raise InputError("data.path", table.path, "a file of at least 2 samples", f"it has {len(time)}")
    late = max(range(len(times)), key=lambda i: times[i][0])
    early = min(range(len(times)), key=lambda i: times[i][-1])
    if times[late][0] > times[early][-1]:
        extents = (
            f"{tables[i].path.name} from {times[i][0]:.9g} to {times[i][-1]:.9g} s" for i in sorted((early, late))
        )
        hint = "data.time_unit, or clocks that were not set together?"
        raise InputError("data.path", ", ".join(extents), "records whose clocks overlap", hint)
