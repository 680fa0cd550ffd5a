"""A sweep as Python has it: the results of its runs, and their tables joined, with the swept settings as columns."""

from __future__ import annotations

import html
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.api.result import Result, as_html
from pinn_cli.api.run_files import check_table
from pinn_cli.sweep.jobs import FINISHED, Job, Sweep

if TYPE_CHECKING:
    import pandas as pd


class SweepResult:
    """The runs of a sweep, those that have finished so far.

    ``len(sweep)``, ``sweep[0]`` and ``for result in sweep`` are about their results.

    Args:
        directory: Of the sweep; absolute.

    Attributes:
        directory: Where its files lie.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._sweep = Sweep.read(directory)
        self._jobs = self._sweep.jobs()

    @cached_property
    def runs(self) -> list[Result]:
        """Of every run that has finished, in the sweep's order."""
        return [Result(job.directory) for job in self._finished]

    @property
    def _finished(self) -> list[Job]:
        return [job for job in self._jobs if job.status == FINISHED]

    def __len__(self) -> int:
        return len(self.runs)

    def __getitem__(self, index: int) -> Result:
        return self.runs[index]

    def __iter__(self) -> Iterator[Result]:
        return iter(self.runs)

    @cached_property
    def jobs(self) -> pd.DataFrame:
        """A row for each run, finished or not: its swept settings, ``status``, ``reason``, ``seconds`` and place."""
        import pandas as pd

        rows = [
            self._columns(job)
            | {"status": job.status, "reason": job.reason, "seconds": job.seconds, "directory": str(job.directory)}
            for job in self._jobs
        ]
        return pd.DataFrame(rows)

    @cached_property
    def fitness(self) -> pd.DataFrame:
        """Of all runs; see :attr:`pinn_cli.Result.fitness`."""
        return self.table("fitness")

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """Of all runs; see :attr:`pinn_cli.Result.parameters`."""
        return self.table("parameters")

    @property
    def tables(self) -> list[str]:
        """Names of all tables that its runs have, and of those of the sweep as a whole."""
        return sorted({name for run in self.runs for name in run.tables} | set(self._own))

    @property
    def _own(self) -> list[str]:
        """Tables about the sweep as a whole."""
        joined = {"jobs", *(name for run in self.runs for name in run.tables)}
        return [file.stem for file in self.directory.glob("*.csv") if file.stem not in joined]

    def table(self, name: str) -> pd.DataFrame:
        """A table of all runs, one below the other, the swept settings as its first columns.

        Raises:
            InputError: No run has such a table.
        """
        import pandas as pd

        check_table(name, self.tables)
        if name in self._own:
            return pd.read_csv(self.directory / f"{name}.csv")
        parts = []
        for job, run in zip(self._finished, self.runs, strict=True):
            if name in run.tables:
                table = run.table(name)
                swept = {k: v for k, v in self._columns(job).items() if k not in table}
                parts.append(pd.concat([pd.DataFrame(swept, index=table.index), table], axis="columns"))
        return pd.concat(parts, ignore_index=True)

    def _columns(self, job: Job) -> dict[str, object]:
        """Swept settings; numbers as such."""
        return {name: _number(value) for name, value in self._sweep.columns(job).items()}

    def __repr__(self) -> str:
        return f"<SweepResult: {len(self.runs)} of {len(self._jobs)} runs have finished; {self.directory}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: what became of every run, and a table of the sweep as a whole, if there is one."""
        own = "\n".join(f"<b>{html.escape(name)}</b>\n{as_html(self.table(name))}" for name in self._own)
        jobs = self.jobs.drop(columns="directory")
        return f"{own}\n{as_html(jobs)}\n<code>{html.escape(str(self.directory))}</code>"


def _number(value: str) -> object:
    for kind in (int, float):
        try:
            return kind(value)
        except ValueError:
            continue
    return value
