"""The paper's cases of Tables 2 and 5 over noise seeds: errors of network and smoother that rest on no single draw."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from pinn_cli.paper.realisations import PINN, Realisation, ScoredRealisations
from pinn_cli.paper.runs import BESIDE, SMOOTHER, TABLES, CaseTable
from pinn_cli.paper.tables import case_title, fitness_groups, fitness_rows
from pinn_cli.report import published
from pinn_cli.report.sheet import Cell, Row, Sheet, block, mark
from pinn_cli.runs.writing import write_table

SEEDS = 10
KEYS = ["case", "estimator", "group", "quantity"]
FITNESS_TABLES = tuple(table for table in TABLES if table.kind == "fitness")
NOTE = (
    "Error in percent, 100 less fitness: mean ± standard deviation over {seeds} draws of the sensors' noise, the force "
    "being the case's own. By 100 RMSE / range, which is comparable with the published values; rows called printed use "
    "100 ‖x − x̃‖ / ‖x − x̄‖. Prescribed parameters are uncertain. Published values are of one draw."
)
PARAMETER_NOTE = (
    "100 |estimate − true| / |true|: mean ± standard deviation over {seeds} draws of the sensors' noise. Intervals: "
    "the share of the 90 % intervals of these parameters, of all draws, that hold the true value. Published errors are "
    "of one draw."
)
_TITLES = {PINN: "ours", SMOOTHER.name: SMOOTHER.title}
_PARAMETERS, _INTERVALS = ("k_2", "k_4", "kappa_2/mu_2", "kappa_4/mu_4"), "Intervals (%)"


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
    """Scores over the seeds, all tables empty where there are none.

    Attributes:
        scored: The realisations.
        rows: One per case, seed, estimator, group and quantity (``seeds.csv``).
        parameters: One per case, seed, estimator and published parameter (``seeds_parameters.csv``).
        summary: Mean and standard deviation over the seeds, one row per `KEYS`: ``seeds``, mean and std of both errors,
            ``range_fitness_mean`` and ``published`` (``summary.csv``).
        parameter_summary: ``case, estimator, parameter, seeds``, mean and std of the error, the share of intervals
            that hold the truth, the published error (``summary_parameters.csv``).
    """

    scored: ScoredRealisations
    rows: pd.DataFrame
    parameters: pd.DataFrame
    summary: pd.DataFrame
    parameter_summary: pd.DataFrame

    @classmethod
    def of(cls, scored: ScoredRealisations) -> SeedScores:
        """Tables of the scores that are there."""
        rows, parameters = (scored.rows(table) for table in ("fitness", "parameters"))
        if rows.empty:
            return cls(scored, rows, parameters, rows, parameters)
        rows["error_percent"] = 100.0 - rows["fitness_percent"]
        rows["range_error_percent"] = 100.0 - rows["range_fitness_percent"]
        summary = _spread(rows.dropna(subset=["error_percent"]), KEYS, ["error_percent", "range_error_percent"])
        summary["range_fitness_mean"] = 100.0 - summary["range_error_percent_mean"]
        given = published.fitness().rename(columns={"fitness_percent": "published"})
        summary = summary.merge(given[["case", "group", "quantity", "published"]], how="left", on=["case", *KEYS[2:]])
        if parameters.empty:
            return cls(scored, rows, parameters, summary, parameters)
        given = published.parameters().rename(columns={"error_percent": "published_error_percent"})
        given = given[["case", "parameter", "published_error_percent"]]
        parameters = parameters.merge(given[["case", "parameter"]], on=["case", "parameter"])
        held = parameters["true"].between(parameters["lower_90"], parameters["upper_90"])
        keys = ["case", "estimator", "parameter"]
        of_parameters = _spread(parameters, keys, ["error_percent"])
        inside = parameters.assign(inside_90_percent=100.0 * held).groupby(keys, sort=False)["inside_90_percent"].mean()
        of_parameters = of_parameters.merge(inside.reset_index(), on=keys).merge(given, on=["case", "parameter"])
        return cls(scored, rows, parameters, summary, of_parameters)

    def write(self, directory: Path) -> Path:
        """Write the four tables; the path of the summary."""
        write_table(self.rows, directory / "seeds.csv")
        write_table(self.parameters, directory / "seeds_parameters.csv")
        write_table(self.parameter_summary, directory / "summary_parameters.csv")
        return write_table(self.summary, directory / "summary.csv")

    @property
    def sheets(self) -> list[Sheet]:
        """One for each of Tables 2 and 5 and one for the parameters."""
        if self.rows.empty:
            return []
        sheets = [_fitness_sheet(table, self.summary) for table in FITNESS_TABLES]
        return [*sheets, *([] if self.parameter_summary.empty else [_parameter_sheet(self.parameter_summary)])]


def _spread(rows: pd.DataFrame, keys: list[str], columns: list[str]) -> pd.DataFrame:
    """``seeds``, ``<column>_mean`` and ``<column>_std`` (of the sample) of each group."""
    grouped = rows.groupby(keys, sort=False)
    found: dict[str, Any] = {"seeds": grouped["seed"].nunique()}
    for column in columns:
        found |= {f"{column}_mean": grouped[column].mean(), f"{column}_std": grouped[column].std()}
    return pd.DataFrame(found).reset_index()


def _fitness_sheet(table: CaseTable, summary: pd.DataFrame) -> Sheet:
    rows = fitness_rows(
        table, {title: summary[summary["estimator"] == name] for name, title in _TITLES.items()},
        lambda row: Cell(f"{100.0 - row['fitness_percent']:.2f}"),
        lambda row: _cell(row, "range_error_percent", 100.0 - row["published"]),
        lambda row: _cell(row, "error_percent"),
    )  # fmt: skip
    title, note = f"{table.title}, over noise seeds", NOTE.format(seeds=_seeds(summary))
    return Sheet(f"seeds_{table.name}", title, note, ("Case", "Estimate"), fitness_groups(table), rows)


def _parameter_sheet(summary: pd.DataFrame) -> Sheet:
    """Of the cases of Table 5, whose parameters are Tables 3 and 4."""
    rows: list[Row] = []
    for case, cells in FITNESS_TABLES[-1].values.groupby("case", sort=False):
        ours = summary[summary["case"] == case]
        given = ours.drop_duplicates("parameter").set_index("parameter")["published_error_percent"].to_dict()
        names = {pair: next((name for name in pair.split("/") if name in given), "") for pair in _PARAMETERS}
        errors = {pair: Cell(f"{given[name]:.2f}") for pair, name in names.items() if name}
        found = {"published": errors | {_INTERVALS: Cell("")}}
        for estimator, source in _TITLES.items():
            own = ours[ours["estimator"] == estimator].set_index("parameter")
            if len(own):
                by_name = own.to_dict("index")
                found[source] = {
                    pair: _cell(by_name[name], "error_percent", given[name])
                    for pair, name in names.items()
                    if name in by_name
                } | {_INTERVALS: Cell(f"{own['inside_90_percent'].mean():.0f}")}
        if len(found) > 1:
            rows += block(case_title(cells), found, (*_PARAMETERS, _INTERVALS))
    title = "Tables 3 and 4: errors of the unknown parameters (%), over noise seeds"
    note, groups = PARAMETER_NOTE.format(seeds=_seeds(summary)), [("", (*_PARAMETERS, _INTERVALS))]
    return Sheet("seeds_parameters", title, note, ("Case", "Estimate"), groups, rows)


def _cell(row: Mapping[Any, Any], column: str, given: float | None = None) -> Cell:
    mean = row[f"{column}_mean"]
    return Cell(spread_text(mean, row[f"{column}_std"]), "" if given is None else mark(mean, given))


def spread_text(mean: float, std: float) -> str:
    """Both with the decimals of a percentage near the mean's size; one draw has no standard deviation."""
    if not math.isfinite(mean):
        return Cell().text
    decimals = 3 if mean < 0.1 else 2 if mean < 10.0 else 1
    spread = f" ± {std:.{decimals}f}" if math.isfinite(std) else ""
    return f"{mean:.{decimals}f}{spread}"


def _seeds(summary: pd.DataFrame) -> str:
    """As many as there are: fewer while the study is unfinished."""
    least, most = int(summary["seeds"].min()), int(summary["seeds"].max())
    return str(most) if least == most else f"{least} to {most} (of {SEEDS})"
