"""Where our values are worse than the published ones, cell by cell, and why as far as the runs tell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pinn_cli.report.comparison import GROUP_TITLES
from pinn_cli.report.paper.plan import SMOOTHER

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.report.paper.tables import PaperTable

NEAR = 0.1  # of fitness in percent: as good as the smoother's, for telling noise from a fault


@dataclass(frozen=True)
class Shortfall:
    """One value of ours that is worse than the published one."""

    table: str
    cell: str
    published: str
    ours: str
    reason: str


def shortfalls(tables: Sequence[PaperTable]) -> list[Shortfall]:
    """Those of the default variants, in the tables' order."""
    found: list[Shortfall] = []
    for table in tables:
        if "below_published" in table.comparison:
            found += _of_fitness(table)
        elif "larger_error" in table.comparison:
            found += _of_parameters(table)
    return found


def counted(table: PaperTable, variant: str) -> tuple[int, int]:
    """How many of a variant's values are worse than the published ones, and of how many."""
    rows = table.comparison
    if "variant" not in rows:
        return 0, 0
    worse = "below_published" if "below_published" in rows else "larger_error"
    ours = rows[rows["variant"] == variant]
    return int(ours[worse].sum()), len(ours)


def _of_fitness(table: PaperTable) -> list[Shortfall]:
    rows = table.comparison
    keys = ["case", "group", "quantity"]
    smoother = rows[rows["variant"] == SMOOTHER.name].set_index(keys)["range_fitness_percent"]
    below = rows[(rows["variant"] == table.default) & rows["below_published"].astype(bool)]
    return [
        Shortfall(
            table.sheet.name.replace("table", "Table "),
            f"{row['case']}, {GROUP_TITLES.get(row['group'], row['group'])}, {row['quantity']}",
            f"{row['published']:.2f} %",
            f"{row['range_fitness_percent']:.2f} %",
            fitness_reason(row, float(smoother.get(tuple(row[key] for key in keys), float("nan")))),
        )
        for row in below.to_dict(orient="records")
    ]


def fitness_reason(row: dict[Any, Any], smoother: float) -> str:
    """Why a cell is below, from what the smoother made of the same record.

    Args:
        row: Of `pinn_cli.report.comparison.compare_fitness`.
        smoother: Its range fitness in percent; NaN where there is none.
    """
    ours = row["range_fitness_percent"]
    if math.isnan(smoother):
        return "No smoother stands beside it, so noise and method cannot be told apart."
    if smoother <= ours + NEAR:
        return f"The smoother reaches {smoother:.2f} % on the same record: no more than the record and the model allow."
    return f"The smoother reaches {smoother:.2f} % on the same record: the shortfall is ours."


def _of_parameters(table: PaperTable) -> list[Shortfall]:
    rows = table.comparison
    larger = rows[(rows["variant"] == table.default) & rows["larger_error"].astype(bool)]
    return [
        Shortfall(
            table.sheet.name.replace("table", "Table "),
            f"{row['case']}, {row['parameter']}",
            f"{row['published_error_percent']:g} % off",
            f"{row['error_percent']:.2f} % off",
            parameter_reason(row),
        )
        for row in larger.to_dict(orient="records")
    ]


def parameter_reason(row: dict[Any, Any]) -> str:
    """Why an error is larger, from the estimate's own uncertainty.

    Args:
        row: Of `pinn_cli.report.parameter_comparison.compare_parameters`.
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
