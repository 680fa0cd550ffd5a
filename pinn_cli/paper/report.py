"""``report.html``: the whole comparison in one file that needs no network, and all that it shows as files beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from pinn_cli.paper.cases import SMOOTHER
from pinn_cli.paper.comparison import PaperTable, paper_tables, write_tables
from pinn_cli.paper.figures import copy_figures, paper_figures
from pinn_cli.paper.layout import GROUP_TITLES
from pinn_cli.paper.nonlinearity import NonlinearityScores, nonlinearity_realisations
from pinn_cli.paper.realisations import PINN, read_scores
from pinn_cli.paper.runs import FinishedRun
from pinn_cli.paper.seeds import SeedScores, seed_realisations
from pinn_cli.paper.sheet import render, write_sheets
from pinn_cli.report.run_record import package_versions
from pinn_cli.runs.writing import write_text

NEAR = 0.1  # of fitness in percent: as good as the smoother's, for telling noise from a fault


def write_report(runs: Sequence[FinishedRun], failures: Sequence[str], output: Path) -> Path:
    """Write tables, figures and the report of what is there: styles and images are in it, and it loads nothing.

    Args:
        runs: Those that are there.
        failures: What went wrong with the others.
        output: The folder; seeds and nonlinearity are shown where their results lie in it.
    """
    tables, images = paper_tables(runs), copy_figures(runs, output / "figures")
    seeds = SeedScores.of(read_scores(seed_realisations(), output / "seeds" / "runs"))
    nonlinearity = NonlinearityScores.of(read_scores(nonlinearity_realisations(), output / "nonlinearity" / "runs"))
    write_tables(tables, output / "tables")
    write_sheets(seeds.sheets, output / "seeds")
    text = render(
        "report.html",
        runs=runs,
        failures=failures,
        tables=tables,
        images=images,
        seeds=seeds,
        nonlinearity=nonlinearity,
        nonlinearity_image=nonlinearity.draw(output / "nonlinearity"),
        figures=paper_figures(),
        smoother=SMOOTHER.name,
        reached=_reached(seeds),
        identifiable=_identifiable(tables),
        without_smoother=_without_smoother(runs),
        shortfalls=shortfalls(tables, seeds),
        versions=package_versions(),
    )
    return write_text(text, output / "report.html")


def _reached(seeds: SeedScores) -> list[tuple[str, int, int]]:
    """Whose, in how many cells of Tables 2 and 5 the mean is at least the published value, and of how many."""
    if seeds.rows.empty:
        return []
    given = seeds.summary.dropna(subset=["published"])
    good = given["range_fitness_mean"].round(2) >= given["published"].round(2)
    whose = {PINN: "Our", SMOOTHER.name: "The Kalman smoother's"}
    counts = ((text, good[given["estimator"] == name]) for name, text in whose.items())
    return [(text, int(cells.sum()), len(cells)) for text, cells in counts if len(cells)]


def _identifiable(tables: Sequence[PaperTable]) -> dict[Any, Any] | None:
    """The row of kappa_2 at 10 dB with the uncertainty that the run found; None where there is no such run."""
    for table in tables:
        rows = table.comparison
        if "larger_error" in rows:
            ours = rows[(rows["case"] == "sp_5dof_snr10") & (rows["parameter"] == "kappa_2")]
            ours = ours[(ours["variant"] == table.default) & ours["std"].notna()]
            for row in ours.to_dict("records"):
                return row
    return None


def _without_smoother(runs: Sequence[FinishedRun]) -> list[str]:
    """The cases where the smoother was asked for and found nothing."""
    return [
        run.planned.case
        for run in runs
        if SMOOTHER.name in " ".join(run.planned.variant.overrides)
        and SMOOTHER.name not in {found.variant for found in run.scores}
    ]


@dataclass(frozen=True)
class Shortfall:
    """One value of ours that is worse than the published one."""

    table: str
    cell: str
    published: str
    ours: str
    reason: str


def shortfalls(tables: Sequence[PaperTable], seeds: SeedScores) -> list[Shortfall]:
    """Those of the default variants, in the tables' order; what other draws of the noise say is among the reasons."""
    found: list[Shortfall] = []
    for table in tables:
        rows, name = table.comparison, table.sheet.name.replace("table", "Table ")
        for column, describe in (("below_published", _of_fitness), ("larger_error", _of_parameters)):
            if column in rows:
                worse = rows[(rows["variant"] == table.default) & rows[column].astype(bool)]
                found += [Shortfall(name, *describe(row, rows, seeds)) for row in worse.to_dict(orient="records")]
    return found


def _of_fitness(row: dict[Any, Any], rows: pd.DataFrame, seeds: SeedScores) -> tuple[str, str, str, str]:
    """All but the table's name."""
    key = {name: row[name] for name in ("case", "group", "quantity")}
    smoother = rows[rows["variant"] == SMOOTHER.name].set_index(list(key))["range_fitness_percent"]
    reason = fitness_reason(row, float(smoother.get(tuple(key.values()), float("nan"))))
    reason += over_seeds(seeds.summary, key, "range_fitness_mean", round(row["published"], 2))
    cell = f"{row['case']}, {GROUP_TITLES.get(row['group'], row['group'])}, {row['quantity']}"
    return cell, f"{row['published']:.2f} %", f"{row['range_fitness_percent']:.2f} %", reason


def fitness_reason(row: dict[Any, Any], smoother: float) -> str:
    """Why a cell is below, from what the smoother made of the same record.

    Args:
        row: Of `pinn_cli.paper.comparison.compare_fitness`.
        smoother: Its range fitness in percent; NaN where there is none.
    """
    ours = row["range_fitness_percent"]
    if math.isnan(smoother):
        return "No smoother stands beside it, so noise and method cannot be told apart."
    if smoother <= ours + NEAR:
        return f"The smoother reaches {smoother:.2f} % on the same record: no more than the record and the model allow."
    return f"The smoother reaches {smoother:.2f} % on the same record: the shortfall is ours."


def _of_parameters(row: dict[Any, Any], rows: pd.DataFrame, seeds: SeedScores) -> tuple[str, str, str, str]:
    """All but the table's name."""
    published, key = row["published_error_percent"], {name: row[name] for name in ("case", "parameter")}
    reason = parameter_reason(row) + over_seeds(
        seeds.parameter_summary, key, "error_percent_mean", -round(published, 2)
    )
    return f"{row['case']}, {row['parameter']}", f"{published:g} % off", f"{row['error_percent']:.2f} % off", reason


def parameter_reason(row: dict[Any, Any]) -> str:
    """Why an error is larger, from the estimate's own uncertainty.

    Args:
        row: Of `pinn_cli.paper.comparison.compare_parameters`.
    """
    if row["case"].endswith("_linear"):
        return (
            "A linear model has no true stiffness to find: what fits best is the equivalent stiffness, the linear one "
            "plus what the cubic spring adds at the amplitudes of this record."
        )
    spread = f"its standard deviation is {100.0 * row['std'] / abs(row['true']):.2g} % of the true value"
    if row["parameter"] == "kappa_2" and row["case"].endswith("_snr10"):
        return f"Barely identifiable at 10 dB: {spread}, so that any one estimate, also the published one, is luck."
    if row["truth_inside"] is True or row["truth_inside"] == "True":
        return f"One draw of the noise: {spread}, and the 90 % interval holds the truth."
    distance = abs(row["estimate"] - row["true"]) / row["std"] if row["std"] > 0 else float("nan")
    return f"The truth lies outside the 90 % interval, {distance:.1f} standard deviations from the estimate; {spread}."


def over_seeds(summary: pd.DataFrame, key: Mapping[str, str], column: str, wanted: float) -> str:
    """What both estimators make of a cell on average over other draws of the noise; empty where there are none.

    Args:
        summary: Of the seeds, with ``column``.
        key: Columns and values of the cell.
        column: Its mean.
        wanted: The published value where more is better; less the published error where less is better.
    """
    if summary.empty:
        return ""
    cells = summary[(summary[list(key)] == pd.Series(dict(key))).all(axis=1)].set_index("estimator")
    if PINN not in cells.index:
        return ""
    sign = 1.0 if wanted > 0 else -1.0
    means = {name: float(cells[column][name]) for name in (PINN, SMOOTHER.name) if name in cells.index}
    kind = "mean" if sign > 0 else "mean error"
    said = f" Over {int(cells['seeds'][PINN])} other draws our {kind} is {means[PINN]:.2f} %"
    said += f", the smoother's {means[SMOOTHER.name]:.2f} %: " if SMOOTHER.name in means else ": "
    if sign * round(means[PINN], 2) >= wanted:
        return said + "this draw is unlucky, not the method."
    if SMOOTHER.name not in means or sign * round(means[SMOOTHER.name], 2) < wanted:
        return said + "the published value is not reached on average by either."
    return said + "the smoother shows that the noise allows it."
