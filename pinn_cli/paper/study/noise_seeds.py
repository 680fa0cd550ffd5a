"""The paper's cases of Tables 2 and 5 over noise seeds: errors of network and smoother that rest on no single draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.paper.plan import cases_of
from pinn_cli.paper.single_tables import FITNESS_TABLES
from pinn_cli.paper.study.job import Job, JobResult, solve
from pinn_cli.paper.study.results import Results, all_rows, make_results, read_results
from pinn_cli.report import published
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SEEDS = 10
PINN = "pinn"
KEYS = ["case", "estimator", "group", "quantity"]


def seed_jobs() -> list[Job]:
    """Every case once with each seed; the force is the case's own, only the noise of the sensors is drawn anew."""
    return [
        Job(f"{case}_seed{seed}", (f"experiment=paper/{case}", "baseline=kalman_smoother"), seed)
        for table in FITNESS_TABLES
        for case in cases_of(table)
        for seed in range(SEEDS)
    ]


@dataclass(frozen=True, eq=False)
class SeedStudy:
    """Scores over the seeds.

    Attributes:
        results: Of the jobs.
        rows: One per case, seed, estimator, group and quantity (``seeds.csv``).
        parameters: One per case, seed, estimator and published parameter (``seeds_parameters.csv``).
        summary: Mean and standard deviation over the seeds, one row per `KEYS` (``summary.csv``).
        parameter_summary: The same of the parameters' errors (``summary_parameters.csv``).
    """

    results: Results
    rows: pd.DataFrame
    parameters: pd.DataFrame
    summary: pd.DataFrame
    parameter_summary: pd.DataFrame

    @property
    def empty(self) -> bool:
        """Whether there is nothing to show."""
        return self.rows.empty


def make_seed_study(directory: Path, solver: Callable[[Job], JobResult] = solve) -> SeedStudy:
    """Solve what is missing in ``<directory>/runs`` and write the tables into ``directory``."""
    study = seed_study(make_results(seed_jobs(), directory / "runs", solver))
    tables = (study.rows, study.parameters, study.summary, study.parameter_summary)
    names = ("seeds", "seeds_parameters", "summary", "summary_parameters")
    for table, name in zip(tables, names, strict=True):
        write_table(table, directory / f"{name}.csv")
    return study


def read_seed_study(directory: Path) -> SeedStudy:
    """What is there and up to date, nothing solved."""
    return seed_study(read_results(seed_jobs(), directory / "runs"))


def seed_study(results: Results) -> SeedStudy:
    """Tables of the results that are there."""
    rows, parameters = (all_rows(results, table) for table in ("fitness", "parameters"))
    if rows.empty:
        return SeedStudy(results, rows, parameters, rows, parameters)
    rows["error_percent"] = 100.0 - rows["fitness_percent"]
    rows["range_error_percent"] = 100.0 - rows["range_fitness_percent"]
    given = published.parameters()[["case", "parameter"]]
    parameters = parameters.merge(given, on=["case", "parameter"]) if len(parameters) else parameters
    return SeedStudy(results, rows, parameters, _summary(rows), _parameter_summary(parameters))


def _summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Columns `KEYS`, ``seeds``, mean and std of both errors, ``range_fitness_mean`` and ``published``."""
    known = rows.dropna(subset=["error_percent"])
    summary = _spread(known, KEYS, ["error_percent", "range_error_percent"])
    summary["range_fitness_mean"] = 100.0 - summary["range_error_percent_mean"]
    given = published.fitness().rename(columns={"fitness_percent": "published"})
    return summary.merge(given[["case", "group", "quantity", "published"]], how="left", on=["case", *KEYS[2:]])


def _parameter_summary(parameters: pd.DataFrame) -> pd.DataFrame:
    """``case, estimator, parameter, seeds``, mean and std of the error, share of intervals that hold the truth."""
    if parameters.empty:
        return parameters
    inside = parameters["true"].between(parameters["lower_90"], parameters["upper_90"])
    keys = ["case", "estimator", "parameter"]
    scored = parameters.assign(inside_90_percent=100.0 * inside)
    summary = _spread(scored, keys, ["error_percent"])
    held = scored.groupby(keys, sort=False)["inside_90_percent"].mean().reset_index()
    given = published.parameters().rename(columns={"error_percent": "published_error_percent"})
    given = given[["case", "parameter", "published_error_percent"]]
    return summary.merge(held, on=keys).merge(given, how="left", on=["case", "parameter"])


def _spread(rows: pd.DataFrame, keys: list[str], columns: list[str]) -> pd.DataFrame:
    """``seeds``, ``<column>_mean`` and ``<column>_std`` (of the sample) of each group."""
    grouped = rows.groupby(keys, sort=False)[columns]
    mean, std = grouped.mean().add_suffix("_mean"), grouped.std().add_suffix("_std")
    order = [f"{column}_{part}" for column in columns for part in ("mean", "std")]
    table = mean.join(std)[order]
    table.insert(0, "seeds", rows.groupby(keys, sort=False)["seed"].nunique())
    return table.reset_index()
