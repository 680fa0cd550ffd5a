"""The tables of a sweep: those of its jobs, one below the other, with the swept settings as leading columns."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path

from pinn_cli.report.fitness import FORMULAS
from pinn_cli.runs.reading import DamagedError, small_text
from pinn_cli.runs.writing import replacing
from pinn_cli.sweep.failure import INPUT
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
# Of those that are computed with: columns of numbers, and others that there must be.
COLUMNS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    FITNESS: (FORMULAS, ("estimator", "group", "quantity")),
    PARAMETERS: (("start",), ("estimator",)),
    "identifiability.csv": (("std", "prior_std"), ()),
    "validation.csv": (("nmse_percent",), ()),
}

Row = Mapping[str, str]


def write_tables(sweep: Sweep, jobs: Sequence[Job]) -> list[Path]:
    """Write each of `TABLES` that the jobs have, and `jobs.csv`, into the sweep's directory.

    Cells are copied as the jobs wrote them, and swept settings lead, but for those that a table has a column of the
    same name for (`seed`, `case`). `fitness.csv` and `parameters.csv` end with `status` and `reason`, and have a row
    for every job that failed. `jobs.csv` has a row for each job: what became of it, and its directory.

    Returns:
        The files written.
    """
    settings = [sweep.columns(job) for job in jobs]
    swept = list(dict.fromkeys(setting for given in settings for setting in given))
    written = [_joined(sweep.directory / name, jobs, settings, swept) for name in TABLES]
    rows = [{**given, **_of(job, sweep)} for job, given in zip(jobs, settings, strict=True)]
    _write(sweep.directory / JOBS, [*swept, STATUS, REASON, "seconds", "directory"], rows)
    return [*filter(None, written), sweep.directory / JOBS]


def judged(job: Job) -> Job:
    """The same job; one that has finished has failed where a table of it is not as it was written."""
    if job.status != FINISHED:
        return job
    for name in TABLES:
        try:
            _check(job.directory / name)
        except DamagedError as error:
            reason = f"{error}; without its run.json it is run again"
            return replace(job, status=FAILED, reason=reason, exit_status=INPUT)
    return job


def _check(path: Path) -> None:
    """As :func:`pinn_cli.runs.reading.read_table`, in a tenth of its time.

    Raises:
        DamagedError: It is no table, or none of that name.
    """
    columns, rows = _read(path)
    numbers, texts = COLUMNS.get(path.name, ((), ()))
    lacking = {*numbers, *texts}.difference(columns) if columns else ()
    if lacking:
        raise DamagedError(path, f"it has no column {min(lacking)}")
    for name in numbers if rows else ():
        try:
            _ = [float(row[name] or "nan") for row in rows]
        except ValueError as error:
            raise DamagedError(path, f"column {name}: {error}") from None


def _of(job: Job, sweep: Sweep) -> dict[str, str]:
    seconds = "" if job.seconds is None else f"{job.seconds:.4g}"
    place = job.directory.relative_to(sweep.directory).as_posix()
    return {STATUS: job.status, REASON: job.reason, "seconds": seconds, "directory": place}


def _joined(path: Path, jobs: Sequence[Job], settings: Sequence[Row], swept: Sequence[str]) -> Path | None:
    """One table of every job, one below the other; None where there is nothing to write."""
    own: dict[str, None] = {}
    rows: list[Row] = []
    ending = (STATUS, REASON) if path.name in _WITH_FAILURES else ()
    for job, given in zip(jobs, settings, strict=True):
        ended = {STATUS: job.status, REASON: job.reason}
        if job.status == FINISHED:
            columns, cells = _read(job.directory / path.name)
            own |= dict.fromkeys(columns)
            rows += [{**given, **ended, **row} for row in cells]
        elif job.status == FAILED and ending:
            rows.append({**given, **ended})
    leading = [setting for setting in swept if setting not in own]
    return _write(path, [*leading, *own, *ending], rows) if rows else None


def _read(path: Path) -> tuple[Sequence[str], list[Row]]:
    """Columns and rows; nothing where there is no such table.

    Raises:
        DamagedError: It is none.
    """
    try:
        reader = csv.DictReader(StringIO(small_text(path), newline=""))
        return reader.fieldnames or (), list(reader)
    except FileNotFoundError:
        return (), []
    except (OSError, ValueError, csv.Error) as error:
        raise DamagedError(path, str(error)) from None


def _write(path: Path, columns: Sequence[str], rows: Sequence[Row]) -> Path:
    with replacing(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return path
