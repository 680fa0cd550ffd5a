"""Finished runs and sweeps as Python has them: their files, their figures, and how a notebook shows them."""

from __future__ import annotations

import html
import os
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinn_cli.runs.histories import read_histories, read_tree
from pinn_cli.runs.reading import read_json, read_table, undamaged
from pinn_cli.runs.resume import FORMAT, RESULT, RunFile
from pinn_cli.runs.workbook import write_workbook
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.sweep.jobs import FINISHED, STORED, Job, Sweep

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from pinn_cli.api.plots import Plots

# Which run it is: columns that are the same in every row of a run's tables.
_RUN = ("case", "scheme", "ndof", "nonlinearity", "model_error", "snr_db", "seed")
_ROWS_SHOWN = 40
# Of fitness and of free runs: empty where there is nothing to compare with.
_SCORE = "fitness_percent"


def load(directory: str | os.PathLike[str]) -> Result | SweepResult:
    """Open the directory of a finished run, or of a sweep, whose runs may still be under way. Nothing is changed there.

    Args:
        directory: As the command prints it at its end.

    Returns:
        The result; of a sweep those of its runs, with their tables joined.

    Raises:
        InputError: It is neither, the run has not finished, or a later release made it.
    """
    place = Path(directory).expanduser().absolute()
    if (place / RESULT).is_file():
        result = Result(place)
        _ = result.run_record  # which tells whether it is one
        return result
    if (place / STORED).is_file():
        return SweepResult(place)
    hint = "it holds no run.json"
    if not place.is_dir():
        hint = "there is no such directory"
    elif (place / ".hydra").is_dir():
        hint = f"the run has not finished: run('resume={place}') goes on with it"
    raise InputError("directory", directory, "the directory of a finished run or of a sweep", hint)


class _Tables:
    """A directory whose tables are read when they are asked for."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    @property
    def tables(self) -> list[str]:
        """Names of all its tables; :meth:`table` reads one."""
        return sorted(file.stem for file in self.directory.glob("*.csv"))

    def table(self, name: str) -> pd.DataFrame:
        """One of its tables, ``drift.csv`` by the name ``drift``.

        Raises:
            InputError: It has no such table.
        """
        from pinn_cli.sweep.collect import NEEDED_COLUMNS

        if name not in self.tables:
            raise InputError("table", name, f"one of {', '.join(self.tables)}", suggestion(name, self.tables))
        with undamaged("directory", self.directory):
            return read_table(self.directory / f"{name}.csv", *NEEDED_COLUMNS.get(f"{name}.csv", ()))

    def to_excel(self, path: str | os.PathLike[str]) -> Path:
        """Write all tables into an Excel file (.xlsx), a sheet for each.

        Raises:
            InputError: It has another suffix, a table has more rows than a sheet, or openpyxl is not installed.
            WriteError: The disk does not take it.
        """
        return write_workbook({name: self.table(name) for name in self.tables}, path)

    def _shown(self, table: pd.DataFrame) -> pd.DataFrame:
        """A table as a property has it: as it is."""
        return table


def _table(name: str, text: str) -> cached_property[pd.DataFrame]:
    """A table as a property."""
    table = cached_property[Any](lambda result: result._shown(result.table(name)))
    table.__doc__ = text
    return table


def _optional(name: str, text: str) -> cached_property[pd.DataFrame | None]:
    """A table that not every run has, as a property."""
    table = cached_property[Any](lambda result: result._shown(result.table(name)) if name in result.tables else None)
    table.__doc__ = text
    return table


class Result(_Tables):
    """A finished run, whose files are read when they are asked for.

    Args:
        directory: Of the run; absolute.

    Attributes:
        directory: Where its files lie.
    """

    fitness = _table(
        "fitness", "Fitness by group of DOFs and quantity, of every estimator, where the truth is known: else no row."
    )
    parameters = _table(
        "parameters", "A row for each: ``estimate``, ``std``, ``lower_90`` and ``upper_90`` beside what was given."
    )
    residuals = _table("residuals", "What the estimate leaves of every sensor.")
    history = _table("history", "A row for each iteration: loss terms and weights.")
    modes = _optional("modes", "Natural frequencies (Hz), damping ratios and shapes, with 90 % intervals, or None.")
    free_run = _optional(
        "free_run", "How well the structure by itself follows, under the measured forces; None where it has not run."
    )
    validation = _optional("validation", "The system on data that no estimator has seen; None without such data.")

    def _shown(self, table: pd.DataFrame) -> pd.DataFrame:
        """Without rows that lack their score; which run it is, the same in every row, stands in the last columns."""
        labels = [name for name in _RUN if name in table]
        table = table[[*(name for name in table if name not in labels), *labels]]
        return table.dropna(subset=[_SCORE]).reset_index(drop=True) if _SCORE in table else table

    @cached_property
    def plot(self) -> Plots:
        """Its figures: ``result.plot.response()``."""
        from pinn_cli.api.plots import Plots

        return Plots(self.directory)

    @cached_property
    def run_record(self) -> RunFile:
        """What ``run.json`` says: seconds by stage, why training stopped, noise levels, versions."""
        with undamaged("directory", self.directory):
            return read_json(self.directory / RESULT, RunFile, FORMAT)

    @property
    def verdict(self) -> str | None:
        """``sound``, or how far the run is from it; None where there is no verdict."""
        return self.run_record.get("verdict")

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the verdict is not sound."""
        return tuple(self.run_record.get("reasons", ()))

    @cached_property
    def response(self) -> xr.Dataset:
        """``displacement``, ``velocity``, ``acceleration``, ``force`` over (``time``, ``dof``), SI units.

        Each has ``<quantity>_std`` beside it, ``<quantity>_observed`` (NaN where there is no sensor) and, where it is
        known, ``<quantity>_true``.
        """
        with undamaged("directory", self.directory):
            return read_histories(self.directory / "response.nc")

    def to_sep005(self) -> list[dict[str, Any]]:
        """:attr:`response` as time series of SDyPy's SEP 5: a map for each estimate, ``displacement.3``.

        ``group`` tells estimates from their standard deviations, ``displacement.3 std``.
        """
        from pinn_cli.api.sep005 import response_as_sep005

        return response_as_sep005(self.response)

    @cached_property
    def posterior(self) -> xr.DataTree | None:
        """Draws of the parameters, in ArviZ's groups; None but with ``scheme=bayesian``."""
        file = self.directory / "posterior.nc"
        if not file.is_file():
            return None
        with undamaged("directory", self.directory):
            return read_tree(file)

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Every setting that it ran with."""
        from omegaconf import OmegaConf

        from pinn_cli.settings.yaml_file import read_yaml

        plain: Any = OmegaConf.to_container(read_yaml(self.directory / ".hydra" / "config.yaml"), resolve=False)
        return dict(plain)

    def __repr__(self) -> str:
        case, verdict = self.run_record.get("case"), self.verdict or "no verdict"
        return f"<Result of {case}: {verdict}; {len(self.parameters)} parameters; {self.directory}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the verdict with its reasons, parameters, and fitness where there is a truth."""
        reasons = "".join(f"<li>{html.escape(reason)}</li>" for reason in self.reasons)
        overall = self.fitness[self.fitness["group"] == "all"]
        parts = [
            f"<b>{html.escape(str(self.run_record.get('case')))}</b>: {html.escape(self.verdict or 'no verdict')}",
            f"<ul>{reasons}</ul>" if reasons else "",
            _as_html(self.parameters.drop(columns=[*_RUN, "estimator"], errors="ignore")),
            _as_html(overall[["estimator", "quantity", "fitness_percent", "range_fitness_percent"]]),
            f"<code>{html.escape(str(self.directory))}</code>",
        ]
        return "\n".join(part for part in parts if part)


class SweepResult(_Tables):
    """The runs of a sweep, those that have finished so far.

    ``len(sweep)``, ``sweep[0]`` and ``for result in sweep`` are about their results.

    Args:
        directory: Of the sweep; absolute.

    Attributes:
        directory: Where its files lie.
        runs: Of every run that has finished, in the sweep's order.
    """

    fitness = _table("fitness", "Of all runs; see :attr:`pinn_cli.Result.fitness`.")
    parameters = _table("parameters", "Of all runs; see :attr:`pinn_cli.Result.parameters`.")

    def __init__(self, directory: Path) -> None:
        super().__init__(directory)
        self._sweep = Sweep.read(directory)
        self._jobs = self._sweep.jobs()
        self._finished = [job for job in self._jobs if job.status == FINISHED]
        self.runs = [Result(job.directory) for job in self._finished]

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
            self._swept(job)
            | {"status": job.status, "reason": job.reason, "seconds": job.seconds, "directory": str(job.directory)}
            for job in self._jobs
        ]
        return pd.DataFrame(rows)

    @property
    def tables(self) -> list[str]:
        """Names of all tables that its runs have, and of those of the sweep as a whole."""
        return sorted({name for run in self.runs for name in run.tables} | set(self._of_sweep))

    @property
    def _of_sweep(self) -> list[str]:
        """Tables about the sweep as a whole."""
        joined = {"jobs", *(name for run in self.runs for name in run.tables)}
        return [file.stem for file in self.directory.glob("*.csv") if file.stem not in joined]

    def table(self, name: str) -> pd.DataFrame:
        """A table of all runs, one below the other, the swept settings as its first columns.

        Raises:
            InputError: No run has such a table.
        """
        import pandas as pd

        if name in self._of_sweep or name not in self.tables:
            return super().table(name)
        parts = []
        for job, run in zip(self._finished, self.runs, strict=True):
            if name in run.tables:
                table = run.table(name)
                swept = {k: v for k, v in self._swept(job).items() if k not in table}
                parts.append(pd.concat([pd.DataFrame(swept, index=table.index), table], axis="columns"))
        return pd.concat(parts, ignore_index=True)

    def _swept(self, job: Job) -> dict[str, object]:
        """Its swept settings; numbers as such."""
        return {name: _number(value) for name, value in self._sweep.columns(job).items()}

    def __repr__(self) -> str:
        return f"<SweepResult: {len(self.runs)} of {len(self._jobs)} runs have finished; {self.directory}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: what became of every run, and a table of the sweep as a whole, if there is one."""
        tables = "\n".join(f"<b>{html.escape(name)}</b>\n{_as_html(self.table(name))}" for name in self._of_sweep)
        jobs = self.jobs.drop(columns="directory")
        return f"{tables}\n{_as_html(jobs)}\n<code>{html.escape(str(self.directory))}</code>"


def _as_html(table: pd.DataFrame) -> str:
    """A table as a notebook shows it, its columns without content left out; "" of an empty one."""
    table = table.dropna(axis="columns", how="all")
    if table.empty:
        return ""
    return str(table.to_html(index=False, na_rep="", float_format="{:.5g}".format, max_rows=_ROWS_SHOWN, border=0))


def _number(value: str) -> object:
    for kind in (int, float):
        try:
            return kind(value)
        except ValueError:
            continue
    return value
