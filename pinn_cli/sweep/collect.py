"""`pinn-run collect=DIRECTORY`, and the end of every sweep: its tables, its summary, its figures, its failures.

The tables are those of its jobs, one below the other, with the swept settings as leading columns.
"""

from __future__ import annotations

import csv
from argparse import Namespace
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path

from pinn_cli.runs.reading import DamagedError, small_text
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.jobs import FAILED, FINISHED, FITNESS, INPUT, REASON, STATUS, STATUSES, Job, Sweep

PARAMETERS, JOBS = "parameters.csv", "jobs.csv"
# In these a job without results is a row as well.
_WITH_FAILURES = (FITNESS, PARAMETERS)
_OF_FINISHED = (
    "residuals", "modes", "drift", "energy", "free_run", "validation", "score", "identifiability",
    "stories", "diagnostics",
)  # fmt: skip
JOINED_TABLES = (*_WITH_FAILURES, *(f"{name}.csv" for name in _OF_FINISHED))
# Of those that are computed with: columns of numbers, and others that there must be. The first are
# `pinn_cli.report.fitness.FORMULAS`, which is slow to import.
NEEDED_COLUMNS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    FITNESS: (("fitness_percent", "range_fitness_percent"), ("estimator", "group", "quantity")),
    PARAMETERS: (("start",), ("estimator",)),
    "identifiability.csv": (("std", "prior_std"), ()),
    "validation.csv": (("nmse_percent",), ()),
}
FAILURES_SHOWN = 20

# Columns and rows, as text.
Table = tuple[list[str], list[list[str]]]


def collected(sweep: Sweep, jobs: list[Job]) -> tuple[list[Job], str]:
    """Write what the sweep's directory holds about all its jobs, and say what has become of them.

    Returns:
        The jobs, as :func:`write_tables` has them; and how many there are of which kind, why some failed, the mean
        fitness by setting, and the models that the jobs differ in, compared.
    """
    texts: list[str] = []
    if any(job.ended for job in jobs):
        # Two seconds of imports, not for --help.
        from pinn_cli.sweep.summary import compared, models_text, summary_text, write_models, write_summary

        jobs = write_tables(sweep, jobs)
        swept = list(dict.fromkeys(setting for job in jobs for setting in sweep.columns(job)))
        summary, models = write_summary(sweep.directory, swept), compared(sweep, jobs)
        if summary is not None:
            texts += ["", summary_text(summary)]
        if models is not None:
            write_models(models, sweep.directory)
            texts += ["", models_text(models)]
    counts = Counter(job.status for job in jobs)
    counted = [f"{counts[status]} {status}" for status in STATUSES if counts[status]]
    failed = [f"  {job.directory.name}: {job.reason}" for job in jobs if job.status == FAILED]
    more = [f"  and {len(failed) - FAILURES_SHOWN} more: jobs.csv"] if len(failed) > FAILURES_SHOWN else []
    lines = [f"{len(jobs)} jobs: {', '.join(counted)}", *failed[:FAILURES_SHOWN], *more, *texts]
    return jobs, "\n".join(lines)


def write_tables(sweep: Sweep, jobs: Sequence[Job]) -> list[Job]:
    """Write each of `JOINED_TABLES` that the jobs have, and `jobs.csv`, into the sweep's directory.

    Cells are copied as the jobs wrote them, and swept settings lead, but for those that a table has a column of the
    same name for (`seed`, `case`). `fitness.csv` and `parameters.csv` end with `status` and `reason`, and have a row
    for every job that failed. `jobs.csv` has a row for each job: what became of it, and its directory.

    Returns:
        The jobs; one that has finished has failed where a table of it is not as it was written.
    """
    pairs = [_read_tables(job) for job in jobs]
    columns = [sweep.columns(job) for job, _ in pairs]
    swept = list(dict.fromkeys(setting for given in columns for setting in given))
    rows = [{**given, STATUS: job.status, REASON: job.reason} for (job, _), given in zip(pairs, columns, strict=True)]
    for name in JOINED_TABLES:
        ending = (STATUS, REASON) if name in _WITH_FAILURES else ()
        header = list(dict.fromkeys(column for _, tables in pairs for column in tables.get(name, ((), ()))[0]))
        joined: list[Mapping[str, str]] = []
        for (job, tables), row in zip(pairs, rows, strict=True):
            if name in tables:
                names, cells = tables[name]
                joined += ({**row, **dict(zip(names, values, strict=False))} for values in cells)
            elif job.status == FAILED and ending:
                joined.append(row)
        if joined:
            _write(sweep.directory / name, [*(s for s in swept if s not in header), *header, *ending], joined)
    for (job, _), row in zip(pairs, rows, strict=True):
        row["seconds"] = "" if job.seconds is None else f"{job.seconds:.4g}"
        row["directory"] = job.directory.relative_to(sweep.directory).as_posix()
    _write(sweep.directory / JOBS, [*swept, STATUS, REASON, "seconds", "directory"], rows)
    return [job for job, _ in pairs]


def _read_tables(job: Job) -> tuple[Job, dict[str, Table]]:
    """A job and its tables by their names; it has failed where one is damaged."""
    if job.status != FINISHED:
        return job, {}
    try:
        return job, {name: table for name in JOINED_TABLES for table in _read(job.directory / name)}
    except DamagedError as error:
        reason = f"{error}; without its run.json it is run again"
        return replace(job, status=FAILED, reason=reason, exit_status=INPUT), {}


def _read(path: Path) -> Iterator[Table]:
    """A table; nothing where there is none. As :func:`pinn_cli.runs.reading.read_table`, in a tenth of its time.

    Raises:
        DamagedError: It is no table, or none of that name.
    """
    numbers, texts = NEEDED_COLUMNS.get(path.name, ((), ()))
    try:
        columns, *rows = [row for row in csv.reader(StringIO(small_text(path), newline="")) if row] or [[]]
        for name in (*numbers, *texts):
            if name not in columns:
                raise ValueError(f"it has no column {name}")
        for name in numbers:
            place = columns.index(name)
            _ = [float(row[place] or "nan") for row in rows if len(row) > place]
    except FileNotFoundError:
        return
    except (OSError, ValueError, csv.Error) as error:
        raise DamagedError(path, str(error)) from None
    yield columns, rows


def _write(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, str]]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def asked_for(options: Namespace) -> Path | None:
    """The directory that `pinn-run collect=DIRECTORY`, given alone, names; None: the command line names none."""
    named = [override for override in options.overrides if setting_of(override) == "collect"]
    if not named:
        return None
    directory = named[-1].partition("=")[2].strip("'\"")
    others = [override for override in options.overrides if override not in named]
    others += [f"--{name}" for name in ("multirun", "cfg") if getattr(options, name)]
    if others:
        raise InputError("collect", directory, "given alone", f"drop {' '.join(others)}")
    return Path(directory)
