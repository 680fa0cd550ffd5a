"""Results of many jobs: one file each, made where it is missing or out of date."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.paper.digests import run_digest, tree_digest
from pinn_cli.paper.study.job import Job, JobResult, as_json, from_json, solve
from pinn_cli.runs.writing import write_json
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

# Of this package only these make results: a better table is no reason to solve everything again.
SOLVING = ("posed.py", "job.py")


@dataclass(frozen=True, eq=False)
class Results:
    """Those jobs whose results are there and up to date.

    Attributes:
        found: In the order of the jobs.
        missing: Those that are not.
        failures: What went wrong, a line each; diverged trainings included.
    """

    found: Mapping[Job, JobResult]
    missing: Sequence[Job]
    failures: Sequence[str]

    @property
    def seconds(self) -> float:
        """That all of them took, one after the other."""
        return sum(float(result.seconds["total"]) for result in self.found.values())


def make_results(jobs: Sequence[Job], directory: Path, solver: Callable[[Job], JobResult] = solve) -> Results:
    """Solve what is missing or out of date, one after the other; each result is kept as it comes.

    Args:
        jobs: In the order in which they are solved.
        directory: Of the results, ``<job>.json``; created where it is missing.
        solver: Solves one job.
    """
    todo, refused = read_results(jobs, directory).missing, []
    print(f"{len(jobs) - len(todo)} of {len(jobs)} up to date", flush=True)
    for number, job in enumerate(todo, start=1):
        start = time.perf_counter()
        try:
            result = solver(job)
        except InputError as error:
            refused.append(f"{job.name}: {error}")
            print(f"failed: {refused[-1]}", file=sys.stderr, flush=True)
            continue
        write_json({"digest": job_digest(job), **as_json(result)}, directory / f"{job.name}.json")
        told = f", diverged: {result.failure}" if result.failure else ""
        print(f"[{number}/{len(todo)}] {job.name}: {time.perf_counter() - start:.1f} s{told}", flush=True)
    results = read_results(jobs, directory)
    return Results(results.found, results.missing, [*results.failures, *refused])


def read_results(jobs: Sequence[Job], directory: Path) -> Results:
    """What is there and up to date; nothing is solved."""
    found = {job: result for job in jobs if (result := _read(job, directory)) is not None}
    failures = [f"{job.name}: {result.failure}" for job, result in found.items() if result.failure]
    return Results(found, [job for job in jobs if job not in found], failures)


def _read(job: Job, directory: Path) -> JobResult | None:
    try:
        content = json.loads((directory / f"{job.name}.json").read_text(encoding="utf-8"))
        return from_json(content) if content["digest"] == job_digest(job) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def job_digest(job: Job) -> str:
    """SHA-256 of the configuration, the code and the versions that a job's result depends on."""
    parts = (_settings_digest(job.overrides), *job.command)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@cache
def _settings_digest(overrides: tuple[str, ...]) -> str:
    """Without the seed, so that a configuration is composed once for all of its seeds."""
    here = Path(__file__).parent
    return run_digest(overrides) + tree_digest([(here, name) for name in SOLVING])


def all_rows(results: Results, table: str) -> pd.DataFrame:
    """A table of all jobs, one below the other, the jobs' own columns first.

    Args:
        results: Of the jobs.
        table: ``fitness`` or ``parameters``.
    """
    rows = [
        {**job.labels(result.strength), **row}
        for job, result in results.found.items()
        for row in getattr(result, table).to_dict("records")
    ]
    return pd.DataFrame(rows)
