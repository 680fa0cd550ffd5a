"""The paper's runs: made where they are missing or out of date, read where they are not."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from pinn_cli.paper.case_runs import CaseFailedError, CaseRun, overrides_of, run_case
from pinn_cli.paper.digests import FINISHED, finished_run, mark_finished, run_digest
from pinn_cli.paper.plan import SMOOTHER, PlannedRun

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from pinn_cli.paper.case_runs import Variant

    Runner = Callable[[str, Variant, Path], CaseRun]


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A run whose files are there and up to date.

    Attributes:
        planned: What was run.
        directory: Where its files lie.
        record: Its ``run.json``.
        process_seconds: Of the whole process, imports and figures included.
    """

    planned: PlannedRun
    directory: Path
    record: dict[str, Any]
    process_seconds: float

    def estimates(self) -> list[CaseRun]:
        """Its rows by estimator: the network's, and the smoother's as a variant of its own, where it found something.

        The smoother's seconds are those of its solution alone, as it has no process of its own.
        """
        seconds = self.record["seconds"]
        tables = [pd.read_csv(self.directory / name) for name in ("fitness.csv", "parameters.csv")]
        kept = {"pinn": (self.planned.variant.name, float(seconds["total"]), self.process_seconds)}
        alone = float(seconds.get("baseline", 0.0))
        kept[SMOOTHER.name] = (SMOOTHER.name, alone, alone)
        found = []
        for estimator, (variant, total, process) in kept.items():
            fitness, parameters = (table[table["estimator"] == estimator] for table in tables)
            if len(fitness):
                found.append(CaseRun(self.planned.case, variant, fitness, total, process, parameters))
        return found


def make_runs(
    planned: Sequence[PlannedRun], directory: Path, runner: Runner = run_case
) -> tuple[list[FinishedRun], list[str]]:
    """Make the runs that are missing or out of date, one after the other, in ``<directory>/<case>_<variant>``.

    Args:
        planned: In the order in which they are made.
        directory: Of all runs; created where it is missing.
        runner: Makes one run in a directory, and raises `CaseFailedError` where it does not end well.

    Returns:
        The runs that are there, and what went wrong with the others.
    """
    finished, failures = [], []
    for number, run in enumerate(planned, start=1):
        progress = f"[{number}/{len(planned)}] {run.case}, {run.variant.title}"
        try:
            entry = _make_run(run, directory / run.name, runner, progress)
        except CaseFailedError as error:
            failures.append(str(error))
            print(f"failed: {error}", file=sys.stderr, flush=True)
            continue
        finished.append(entry)
    return finished, failures


def read_runs(planned: Sequence[PlannedRun], directory: Path) -> list[FinishedRun]:
    """Those that are there and up to date; nothing is run."""
    found = []
    for run in planned:
        place = directory / run.name
        known = finished_run(place, run_digest(overrides_of(run.case, run.variant)))
        if known is not None:
            found.append(_read_run(run, place, float(known["process_seconds"])))
    return found


def _read_run(run: PlannedRun, directory: Path, process_seconds: float) -> FinishedRun:
    record = json.loads((directory / "run.json").read_text(encoding="utf-8"))
    return FinishedRun(run, directory, record, process_seconds)


def _make_run(run: PlannedRun, directory: Path, runner: Runner, progress: str) -> FinishedRun:
    digest = run_digest(overrides_of(run.case, run.variant))
    known = finished_run(directory, digest)
    if known is None:
        print(f"{progress}: running", flush=True)
        # While it runs, nothing may say that it has finished.
        (directory / FINISHED).unlink(missing_ok=True)
        done = runner(run.case, run.variant, directory)
        mark_finished(directory, digest, done.process_seconds)
        known = {"process_seconds": done.process_seconds}
        print(f"{progress}: {done.process_seconds:.1f} s", flush=True)
    else:
        print(f"{progress}: up to date", flush=True)
    return _read_run(run, directory, float(known["process_seconds"]))
