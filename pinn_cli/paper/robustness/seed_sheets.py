"""Tables 2 and 5, and the parameters of Table 5's cases, as mean and spread over noise seeds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from pinn_cli.paper.cases import SMOOTHER
from pinn_cli.paper.fitness_sheet import by_cell, case_title, fitness_row, laid_out
from pinn_cli.paper.robustness.noise_seeds import FITNESS_TABLES, SEEDS
from pinn_cli.paper.robustness.realisation import PINN
from pinn_cli.paper.sheet import DASH, Cell, Row, Sheet, mark

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from pinn_cli.paper.cases import CaseTable
    from pinn_cli.paper.robustness.noise_seeds import SeedScores

_TITLES = {PINN: "ours", SMOOTHER.name: SMOOTHER.title}
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


def seed_sheets(seeds: SeedScores) -> list[Sheet]:
    """One for each of Tables 2 and 5 and one for the parameters; cases without a result are left out."""
    if seeds.empty:
        return []
    sheets = [_fitness_sheet(table, seeds.summary) for table in FITNESS_TABLES]
    return [*sheets, *([] if seeds.parameter_summary.empty else [_parameter_sheet(seeds.parameter_summary)])]


def _fitness_sheet(table: CaseTable, summary: pd.DataFrame) -> Sheet:
    columns = {str(group): list(dict.fromkeys(cells["quantity"])) for group, cells in table.values.groupby(
               "group", sort=False)}  # fmt: skip
    rows: list[Row] = []
    for case, published in table.values.groupby("case", sort=False):
        ours = summary[summary["case"] == case]
        if ours.empty:
            continue
        errors = (100.0 - by_cell(published)["fitness_percent"]).to_dict()
        cells = {key: Cell(f"{error:.2f}") for key, error in errors.items()}
        rows.append(fitness_row(case_title(published), "published", cells, columns))
        printed = []
        for name, title in _TITLES.items():
            found = by_cell(ours[ours["estimator"] == name]).to_dict("index")
            if found:
                ranged = {key: _spread(row, "range_error_percent", errors.get(key)) for key, row in found.items()}
                rows.append(fitness_row("", title, ranged, columns))
                strict = {key: _spread(row, "error_percent") for key, row in found.items()}
                printed.append(fitness_row("", f"{title}, printed", strict, columns))
        rows += printed
    title = f"{table.title}, over noise seeds"
    return laid_out(f"seeds_{table.name}", title, NOTE.format(seeds=_seeds(summary)), columns, rows)


def _spread(row: Mapping[Any, Any] | None, column: str, given: float | None = None) -> Cell:
    if row is None:
        return Cell(DASH)
    mean = row[f"{column}_mean"]
    return Cell(spread_text(mean, row[f"{column}_std"]), "" if given is None else mark(mean, given))


def spread_text(mean: float, std: float) -> str:
    """Both with the decimals of a percentage near the mean's size; one draw has no standard deviation."""
    if not math.isfinite(mean):
        return DASH
    decimals = 3 if mean < 0.1 else 2 if mean < 10.0 else 1
    spread = f" ± {std:.{decimals}f}" if math.isfinite(std) else ""
    return f"{mean:.{decimals}f}{spread}"


def _parameter_sheet(summary: pd.DataFrame) -> Sheet:
    rows: list[Row] = []
    for case, published in FITNESS_TABLES[-1].values.groupby("case", sort=False):  # whose parameters are Tables 3 and 4
        ours = summary[summary["case"] == case]
        if len(ours):
            rows += _parameter_rows(case_title(published), ours)
    columns = ("k_2", "k_4", "kappa_2/mu_2", "kappa_4/mu_4", "Intervals (%)")
    return Sheet(
        "seeds_parameters", "Tables 3 and 4: errors of the unknown parameters (%), over noise seeds",
        PARAMETER_NOTE.format(seeds=_seeds(summary)), ("Case", "Estimate"), (("", len(columns)),), columns, tuple(rows),
    )  # fmt: skip


def _parameter_rows(title: str, ours: pd.DataFrame) -> list[Row]:
    first = ours.drop_duplicates("parameter").set_index("parameter")["published_error_percent"].to_dict()
    names = [next((name for name in first if name in pair), "") for pair in
             (("k_2",), ("k_4",), ("kappa_2", "mu_2"), ("kappa_4", "mu_4"))]  # fmt: skip
    cells = [Cell(f"{first[name]:.2f}") if name else Cell(DASH) for name in names]
    rows = [Row((title, "published"), (*cells, Cell("")), begins=True)]
    for estimator, source in _TITLES.items():
        found = ours[ours["estimator"] == estimator].set_index("parameter").to_dict("index")
        if found:
            values = [_spread(found.get(name), "error_percent", first.get(name)) for name in names]
            held = sum(row["inside_90_percent"] for row in found.values()) / len(found)
            rows.append(Row(("", source), (*values, Cell(f"{held:.0f}"))))
    return rows


def _seeds(summary: pd.DataFrame) -> str:
    """As many as there are: fewer while the study is unfinished."""
    least, most = int(summary["seeds"].min()), int(summary["seeds"].max())
    return str(most) if least == most else f"{least} to {most} (of {SEEDS})"
