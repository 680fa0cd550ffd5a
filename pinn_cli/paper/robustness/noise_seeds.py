"""The paper's cases of Tables 2 and 5 over noise seeds: errors of network and smoother that rest on no single draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.paper.cases import BESIDE, TABLES
from pinn_cli.paper.robustness.realisation import Realisation
from pinn_cli.report import published
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from pathlib import Path

    from pinn_cli.paper.robustness.scored import ScoredRealisations

SEEDS = 10
KEYS = ["case", "estimator", "group", "quantity"]
FITNESS_TABLES = tuple(table for table in TABLES if table.kind == "fitness")


def seed_realisations() -> list[Realisation]:
    """Every case once with each seed; the force is the case's own, only the noise of the sensors is drawn anew."""
    return [
        Realisation(f"{case}_seed{seed}", (f"experiment=paper/{case}", *BESIDE), seed)
        for table in FITNESS_TABLES
        for case in table.cases
        for seed in range(SEEDS)
    ]


@dataclass(frozen=True, eq=False)
class SeedScores:
    """Scores over the seeds.

    Attributes:
        scored: The realisations.
        rows: One per case, seed, estimator, group and quantity (``seeds.csv``).
        parameters: One per case, seed, estimator and published parameter (``seeds_parameters.csv``).
        summary: Mean and standard deviation over the seeds, one row per `KEYS` (``summary.csv``).
        parameter_summary: The same of the parameters' errors (``summary_parameters.csv``).
    """

    scored: ScoredRealisations
    rows: pd.DataFrame
    parameters: pd.DataFrame
    summary: pd.DataFrame
    parameter_summary: pd.DataFrame

    @property
    def empty(self) -> bool:
        """Whether there is nothing to show."""
        return self.rows.empty

    @classmethod
    def of(cls, scored: ScoredRealisations) -> SeedScores:
        """Tables of the scores that are there."""
        rows, parameters = (scored.rows(table) for table in ("fitness", "parameters"))
        if rows.empty:
            return cls(scored, rows, parameters, rows, parameters)
        rows["error_percent"] = 100.0 - rows["fitness_percent"]
        rows["range_error_percent"] = 100.0 - rows["range_fitness_percent"]
        given = published.parameters()[["case", "parameter"]]
        parameters = parameters.merge(given, on=["case", "parameter"]) if len(parameters) else parameters
        return cls(scored, rows, parameters, _summary(rows), _parameter_summary(parameters))

    def write(self, directory: Path) -> Path:
        """Write the four tables; the path of the summary."""
        write_table(self.rows, directory / "seeds.csv")
        write_table(self.parameters, directory / "seeds_parameters.csv")
        write_table(self.parameter_summary, directory / "summary_parameters.csv")
        return write_table(self.summary, directory / "summary.csv")


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
