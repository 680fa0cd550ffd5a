"""Where our values are worse than the published ones, cell by cell, and why as far as the runs tell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from pinn_cli.paper.cases import SMOOTHER
from pinn_cli.paper.fitness_sheet import GROUP_TITLES
from pinn_cli.paper.robustness.realisation import PINN

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pinn_cli.paper.robustness.noise_seeds import SeedScores
    from pinn_cli.paper.tables import PaperTable

NEAR = 0.1  # of fitness in percent: as good as the smoother's, for telling noise from a fault


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
    reason += _over_seeds(seeds.summary, key, "range_fitness_mean", round(row["published"], 2))
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
    reason = parameter_reason(row) + _over_seeds(
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


def _over_seeds(summary: pd.DataFrame, key: Mapping[str, str], column: str, wanted: float) -> str:
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
