"""The paper's runs: made where they are missing or out of date, read where they are not."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from pinn_cli.paper.cases import SMOOTHER, PlannedRun
from pinn_cli.paper.digests import keep, kept, run_digest
from pinn_cli.settings.override_syntax import quoted

Runner = Callable[[PlannedRun, Path], float]

# Written last into the directory of a run.
FINISHED = "finished.json"


class CaseFailedError(RuntimeError):
    """A run that did not end well: the command and the end of what it wrote."""


@dataclass(frozen=True)
class CaseScores:
    """What one estimator made of one case.

    Attributes:
        case: Of ``conf/experiment/paper``.
        variant: Name of the variant, or of the smoother.
        fitness: Its rows of ``fitness.csv``.
        parameters: Its rows of ``parameters.csv``.
        seconds: Total of ``run.json``; of the smoother's solution alone.
        process_seconds: From starting the process to its end, imports and figures included; of the smoother as above.
    """

    case: str
    variant: str
    fitness: pd.DataFrame
    parameters: pd.DataFrame
    seconds: float
    process_seconds: float


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

    @cached_property
    def scores(self) -> list[CaseScores]:
        """The network's, and the smoother's as a variant of its own, where it found something."""
        tables = [pd.read_csv(self.directory / name) for name in ("fitness.csv", "parameters.csv")]
        seconds = self.record["seconds"]
        alone = float(seconds.get("baseline", 0.0))
        estimators = {
            "pinn": (self.planned.variant.name, float(seconds["total"]), self.process_seconds),
            SMOOTHER.name: (SMOOTHER.name, alone, alone),
        }
        found = []
        for estimator, (variant, total, process) in estimators.items():
            fitness, parameters = (table[table["estimator"] == estimator] for table in tables)
            if len(fitness):
                found.append(CaseScores(self.planned.case, variant, fitness, parameters, total, process))
        return found


def run_case(run: PlannedRun, directory: Path) -> float:
    """Run ``pinn-run experiment=paper/<case>`` in ``directory``.

    Returns:
        Seconds of the whole process.

    Raises:
        CaseFailedError: If the process ends with another status than 0, or leaves no results.
    """
    results = directory / "run.json"
    results.unlink(missing_ok=True)  # of an earlier run: it must not pass for this one's
    place = f"hydra.run.dir={quoted(str(directory.resolve()))}"
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "pinn_cli.main", *run.overrides, place], capture_output=True, text=True, check=False
    )
    if done.returncode != 0 or not results.exists():
        tail = "\n".join((done.stderr or done.stdout).splitlines()[-10:])
        raise CaseFailedError(f"{run.title}: exit status {done.returncode}\n{tail}")
    return time.perf_counter() - start


def make_runs(
    planned: Sequence[PlannedRun], directory: Path, runner: Runner = run_case, at_once: int = 1
) -> tuple[list[FinishedRun], list[str]]:
    """Make the runs that are missing or out of date in ``<directory>/<case>_<variant>``.

    Args:
        planned: In the order in which they are begun.
        directory: Of all runs; created where it is missing.
        runner: Makes one run in a directory and returns its seconds; raises `CaseFailedError` where it fails.
        at_once: How many.

    Returns:
        The runs that are there, and what went wrong with the others.
    """
    failures = []
    digests = [run_digest(run.overrides) for run in planned]  # here: Hydra composes in one thread alone
    with ThreadPoolExecutor(at_once) as pool:
        begun = [
            pool.submit(_make_run, run, directory / run.name, digest, runner, f"[{number}/{len(planned)}] {run.title}")
            for number, (run, digest) in enumerate(zip(planned, digests, strict=True), start=1)
        ]
        try:
            for made in begun:
                try:
                    made.result()
                except CaseFailedError as error:
                    failures.append(str(error))
                    print(f"failed: {error}", file=sys.stderr, flush=True)
        except BaseException:  # Ctrl-C, which those that run have had as well
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return read_runs(planned, directory), failures


def read_runs(planned: Sequence[PlannedRun], directory: Path) -> list[FinishedRun]:
    """Those that are there and up to date; nothing is run."""
    found = []
    for run in planned:
        place = directory / run.name
        if (content := kept(place / FINISHED, run_digest(run.overrides))) is not None:
            record = json.loads((place / "run.json").read_text(encoding="utf-8"))
            found.append(FinishedRun(run, place, record, content["process_seconds"]))
    return found


def _make_run(run: PlannedRun, directory: Path, digest: str, runner: Runner, progress: str) -> None:
    if kept(directory / FINISHED, digest) is not None:
        print(f"{progress}: up to date", flush=True)
        return
    print(f"{progress}: running", flush=True)
    # While it runs, nothing may say that it has finished.
    (directory / FINISHED).unlink(missing_ok=True)
    seconds = runner(run, directory)
    keep({"process_seconds": seconds}, digest, directory / FINISHED)
    print(f"{progress}: {seconds:.1f} s", flush=True)
