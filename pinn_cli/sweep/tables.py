"""The tables of a sweep: those of its jobs, one below the other, with the swept settings as leading columns."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

from pinn_cli.runs.writing import replacing
from pinn_cli.sweep.jobs import FAILED, FINISHED, Job, Sweep

FITNESS, PARAMETERS, JOBS = "fitness.csv", "parameters.csv", "jobs.csv"
# In these a job without results is a row as well.
_WITH_FAILURES = (FITNESS, PARAMETERS)
_OF_FINISHED = (
    "residuals", "modes", "drift", "energy", "free_run", "validation", "score", "identifiability",
    "stories", "diagnostics",
)  # fmt: skip
TABLES = (*_WITH_FAILURES, *(f"{name}.csv" for name in _OF_FINISHED))
STATUS, REASON = "status", "reason"

Settings = dict[str, str]
Row = list[str]


def write_tables(sweep: Sweep, jobs: Sequence[Job]) -> list[Path]:
    """Write each of `TABLES` that the jobs have, and `jobs.csv`, into the sweep's directory.

    Cells are copied as the jobs wrote them. `fitness.csv` and `parameters.csv` end with `status` and `reason`, and have
    a row for every job that failed.

    Returns:
        The files written.
    """
    settings = [sweep.columns(job) for job in jobs]
    joined = (join_tables(sweep.directory, name, jobs, settings) for name in TABLES)
    return [*filter(None, joined), _write_jobs(sweep.directory, jobs, settings)]


def join_tables(directory: Path, name: str, jobs: Sequence[Job], settings: Sequence[Settings]) -> Path | None:
    """Concatenate one table of every job.

    A setting that the table has a column of the same name for (`seed`, `case`) becomes no second one.

    Args:
        directory: Of the sweep.
        name: One of `TABLES`.
        jobs: Of the sweep.
        settings: Swept settings of each and their values, as text.

    Returns:
        The path written, or None if there is nothing to write.
    """
    tables = [_read(job.directory / name) if job.status == FINISHED else ([], []) for job in jobs]
    with_failures = name in _WITH_FAILURES
    own = list(dict.fromkeys(column for head, _ in tables for column in head))
    swept = [setting for setting in _all(settings) if setting not in own]
    rows: list[Row] = []
    for job, given, (head, cells) in zip(jobs, settings, tables, strict=True):
        leading = [given.get(setting, "") for setting in swept]
        trailing = [job.status, job.reason] if with_failures else []
        if head and head == own:
            rows += [[*leading, *row, *trailing] for row in cells]
        elif head:
            rows += [[*leading, *_reordered(head, row, own), *trailing] for row in cells]
        elif with_failures and job.status == FAILED:
            rows.append([*leading, *(given.get(column, "") for column in own), *trailing])
    return (
        _write(directory / name, [*swept, *own, *([STATUS, REASON] if with_failures else [])], rows) if rows else None
    )


def _write_jobs(directory: Path, jobs: Sequence[Job], settings: Sequence[Settings]) -> Path:
    """A row per job with its swept settings, what became of it, and its directory."""
    swept = _all(settings)
    rows = []
    for job, given in zip(jobs, settings, strict=True):
        seconds = "" if job.seconds is None else f"{job.seconds:.4g}"
        place = job.directory.relative_to(directory).as_posix()
        rows.append([*(given.get(setting, "") for setting in swept), job.status, job.reason, seconds, place])
    return _write(directory / JOBS, [*swept, STATUS, REASON, "seconds", "directory"], rows)


def _reordered(head: Row, row: Row, columns: Row) -> Iterator[str]:
    cells = dict(zip(head, row, strict=True))
    return (cells.get(column, "") for column in columns)


def _all(settings: Sequence[Settings]) -> list[str]:
    return list(dict.fromkeys(setting for given in settings for setting in given))


def _read(path: Path) -> tuple[Row, list[Row]]:
    """Head and cells; nothing where there is no such table."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            head, *cells = csv.reader(file)
    except (FileNotFoundError, ValueError):
        return [], []
    return head, cells


def _write(path: Path, head: Row, rows: Sequence[Row]) -> Path:
    with replacing(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])
    return path
