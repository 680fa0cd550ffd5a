"""Runs of the paper's cases, each in a process of its own: what ``make table2`` and its like collect."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.settings.override_syntax import quoted

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


@dataclass(frozen=True)
class Variant:
    """One way to run every case of a table.

    Attributes:
        name: A word for file and column names.
        title: What the printed table calls it.
        overrides: Settings as `pinn-run` takes them.
    """

    name: str
    title: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class CaseRun:
    """What a finished run left behind.

    Attributes:
        fitness: The rows of its ``fitness.csv``.
        seconds: Total of its ``run.json``.
        process_seconds: From starting the process to its end, imports and figures included.
        parameters: The rows of its ``parameters.csv``.
    """

    case: str
    variant: str
    fitness: pd.DataFrame
    seconds: float
    process_seconds: float
    parameters: pd.DataFrame = field(default_factory=pd.DataFrame)


class CaseFailedError(RuntimeError):
    """A run that did not end well: the command and the end of what it wrote."""


def run_case(case: str, variant: Variant, directory: Path) -> CaseRun:
    """Run ``pinn-run experiment=paper/<case>`` in ``directory`` and read its tables.

    Raises:
        CaseFailedError: If the process ends with another status than 0, or leaves no tables.
    """
    for name in ("fitness.csv", "parameters.csv", "run.json"):
        (directory / name).unlink(missing_ok=True)  # of an earlier run: they must not pass for this one's
    command = [*command_of(case, variant), f"hydra.run.dir={quoted(str(directory.resolve()))}"]
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    process_seconds = time.perf_counter() - start
    if done.returncode != 0:
        tail = "\n".join((done.stderr or done.stdout).splitlines()[-10:])
        raise CaseFailedError(f"{case}, {variant.title}: exit status {done.returncode}\n{tail}")
    try:
        fitness, parameters = (pd.read_csv(directory / name) for name in ("fitness.csv", "parameters.csv"))
        seconds = json.loads((directory / "run.json").read_text(encoding="utf-8"))["seconds"]["total"]
    except (OSError, KeyError, ValueError) as error:
        raise CaseFailedError(f"{case}, {variant.title}: {error}") from error
    return CaseRun(case, variant.name, fitness, float(seconds), process_seconds, parameters)


def command_of(case: str, variant: Variant) -> list[str]:
    """The command of a run, as a list of arguments."""
    return [sys.executable, "-m", "pinn_cli.main", *overrides_of(case, variant)]


def overrides_of(case: str, variant: Variant) -> list[str]:
    """The overrides of a run, as `pinn-run` takes them."""
    return [f"experiment=paper/{case}", *variant.overrides]


def run_cases(cases: Sequence[str], variants: Sequence[Variant], directory: Path) -> tuple[list[CaseRun], list[str]]:
    """Run every case with every variant, one after the other, in ``directory/<case>_<variant>``.

    Returns:
        The runs that ended well, and what went wrong with the others.
    """
    runs, failures = [], []
    for case in cases:
        for variant in variants:
            try:
                run = run_case(case, variant, directory / f"{case}_{variant.name}")
            except CaseFailedError as error:
                failures.append(str(error))
                print(f"failed: {error}", file=sys.stderr, flush=True)
                continue
            runs.append(run)
            print(f"{case}, {variant.title}: {run.process_seconds:.1f} s", flush=True)
    return runs, failures
