"""Two studies beyond the paper: its cases over noise seeds, and fitness against how nonlinear the chain is.

The first gives errors of network and smoother that rest on no single draw; the second has right and wrong models.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from pinn_cli.paper.realisations import PINN, Realisation, ScoredRealisations
from pinn_cli.paper.runs import SMOOTHER, TABLES, WITH_SMOOTHER, CaseTable
from pinn_cli.paper.tables import case_title, fitness_groups, fitness_rows
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.report.fitness import published
from pinn_cli.report.sheet import Cell, Row, Sheet, block, mark
from pinn_cli.runs.writing import write_table

SEEDS = 10
SEED_KEYS = ["case", "estimator", "group", "quantity"]
FITNESS_TABLES = tuple(table for table in TABLES if table.kind == "fitness")
SEEDS_FITNESS_NOTE = (
    "Error in percent, 100 less fitness: mean ± standard deviation over {seeds} draws of the sensors' noise, the force "
    "being the case's own. By 100 RMSE / range, which is comparable with the published values; rows called printed use "
    "100 ‖x − x̃‖ / ‖x − x̄‖. Prescribed parameters are uncertain. Published values are of one draw."
)
SEEDS_PARAMETER_NOTE = (
    "100 |estimate − true| / |true|: mean ± standard deviation over {seeds} draws of the sensors' noise. Intervals: "
    "the share of the 90 % intervals of these parameters, of all draws, that hold the true value. Published errors are "
    "of one draw."
)
_ESTIMATORS = {PINN: "ours", SMOOTHER.name: SMOOTHER.title}
_PARAMETERS, _INTERVALS = ("k_2", "k_4", "kappa_2/mu_2", "kappa_4/mu_4"), "Intervals (%)"

# N/m^3 and N; 100 N/m^3 and 1 N are the defaults of the chain and of the force.
KAPPAS = (0.0, 10.0, 100.0, 1000.0, 10000.0)
FORCES = (0.3, 1.0, 3.0, 10.0)
MODEL_ERRORS = {"none": "right model", "linear": "linear model", "perturbed": "wrong values"}
FORCE_DRAWS = 2  # of force and noise together: one draw of the force may happen to dwell at one amplitude
GRID_KEYS = ["model_error", "kappa", "force_rms", "estimator", "quantity"]
_SMALLEST, _LARGEST = 0.03, 100.0  # errors in percent, the ends of the colours
_DARK = 3.0  # errors from here up stand on a dark ground


def seed_realisations() -> list[Realisation]:
    """Every case once with each seed; the force is the case's own, only the noise of the sensors is drawn anew."""
    return [
        Realisation(f"{case}_seed{seed}", (f"experiment=paper/{case}", *WITH_SMOOTHER), seed)
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
        summary: Mean and standard deviation over the seeds, one row per `SEED_KEYS`: ``seeds``, mean and std of both
            errors, ``range_fitness_mean`` and ``published`` (``summary.csv``).
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
        summary = _spread(rows.dropna(subset=["error_percent"]), SEED_KEYS, ["error_percent", "range_error_percent"])
        summary["range_fitness_mean"] = 100.0 - summary["range_error_percent_mean"]
        given = published("fitness").rename(columns={"fitness_percent": "published"})
        cell = ["case", "group", "quantity"]
        summary = summary.merge(given[[*cell, "published"]], how="left", on=cell)
        if parameters.empty:
            return cls(scored, rows, parameters, summary, parameters)
        given = published("parameters").rename(columns={"error_percent": "published_error_percent"})
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
    statistics: dict[str, Any] = {"seeds": grouped["seed"].nunique()}
    for column in columns:
        statistics |= {f"{column}_mean": grouped[column].mean(), f"{column}_std": grouped[column].std()}
    return pd.DataFrame(statistics).reset_index()


def _fitness_sheet(table: CaseTable, summary: pd.DataFrame) -> Sheet:
    rows = fitness_rows(
        table, {title: summary[summary["estimator"] == name] for name, title in _ESTIMATORS.items()},
        lambda row: Cell(f"{100.0 - row['fitness_percent']:.2f}"),
        lambda row: _cell(row, "range_error_percent", 100.0 - row["published"]),
        lambda row: _cell(row, "error_percent"),
    )  # fmt: skip
    title, note = f"{table.title}, over noise seeds", SEEDS_FITNESS_NOTE.format(seeds=_seeds(summary))
    return Sheet(f"seeds_{table.name}", title, note, ("Case", "Estimate"), fitness_groups(table), rows)


def _parameter_sheet(summary: pd.DataFrame) -> Sheet:
    """Of the cases of Table 5, whose parameters are Tables 3 and 4."""
    rows: list[Row] = []
    for case, cells in FITNESS_TABLES[-1].values.groupby("case", sort=False):
        ours = summary[summary["case"] == case]
        given = ours.drop_duplicates("parameter").set_index("parameter")["published_error_percent"].to_dict()
        names = {pair: next((name for name in pair.split("/") if name in given), "") for pair in _PARAMETERS}
        errors = {pair: Cell(f"{given[name]:.2f}") for pair, name in names.items() if name}
        by_source = {"published": errors | {_INTERVALS: Cell("")}}
        for estimator, source in _ESTIMATORS.items():
            of_estimator = ours[ours["estimator"] == estimator].set_index("parameter")
            if len(of_estimator):
                by_name = of_estimator.to_dict("index")
                by_source[source] = {
                    pair: _cell(by_name[name], "error_percent", given[name])
                    for pair, name in names.items()
                    if name in by_name
                } | {_INTERVALS: Cell(f"{of_estimator['inside_90_percent'].mean():.0f}")}
        if len(by_source) > 1:
            rows += block(case_title(cells), by_source, (*_PARAMETERS, _INTERVALS))
    title = "Tables 3 and 4: errors of the unknown parameters (%), over noise seeds"
    note, groups = SEEDS_PARAMETER_NOTE.format(seeds=_seeds(summary)), [("", (*_PARAMETERS, _INTERVALS))]
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


def nonlinearity_realisations() -> list[Realisation]:
    """Six DOFs, 50 dB, defaults but for kappa, the force's root mean square and the model error."""
    return [
        Realisation(
            f"{model_error}_kappa{kappa:g}_force{force:g}_seed{seed}",
            (f"system.kappa={kappa}", f"excitation.rms={force}", f"model_error={model_error}", *WITH_SMOOTHER),
            seed, redraws_force=True, columns=(("kappa", kappa), ("force_rms", force)),
        )
        for seed in range(FORCE_DRAWS)
        for model_error in MODEL_ERRORS
        for kappa in KAPPAS
        for force in FORCES
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class NonlinearityScores:
    """Fitness over the grid.

    Attributes:
        scored: The realisations.
        rows: One per realisation, estimator and quantity, over all DOFs (``nonlinearity_by_seed.csv``).
        summary: Mean over the seeds, one row per `GRID_KEYS`, with the mean ``strength``, the worst fitness and the
            number of ``seeds`` that there are (``nonlinearity.csv``).
    """

    scored: ScoredRealisations
    rows: pd.DataFrame
    summary: pd.DataFrame

    @classmethod
    def of(cls, scored: ScoredRealisations) -> NonlinearityScores:
        """Tables of the scores that are there."""
        rows = scored.rows("fitness")
        if rows.empty:
            return cls(scored, rows, rows)
        rows = rows[(rows["group"] == "all") & rows["quantity"].isin(RESPONSE_QUANTITIES)].reset_index(drop=True)
        grouped = rows.groupby(GRID_KEYS, sort=False)
        summary = grouped[["strength", "fitness_percent", "range_fitness_percent"]].mean()
        summary["worst_fitness_percent"] = grouped["fitness_percent"].min()
        summary.insert(1, "seeds", grouped["seed"].nunique())
        return cls(scored, rows, summary.reset_index())

    def write(self, directory: Path) -> Path:
        """Write both tables; the path of the summary."""
        write_table(self.rows, directory / "nonlinearity_by_seed.csv")
        return write_table(self.summary, directory / "nonlinearity.csv")

    def draw(self, directory: Path) -> Path | None:
        """Draw ``nonlinearity.png`` and ``.pdf``; the former's path, None where there is nothing to draw."""
        if self.summary.empty:
            return None
        return style.save(nonlinearity_figure(self.summary), directory, "nonlinearity")[0]


@style.look()
def nonlinearity_figure(summary: pd.DataFrame) -> Figure:
    """Draw the summary of `NonlinearityScores`; cells that it lacks are left empty."""
    positive = summary.loc[summary["strength"] > 0.0, "strength"]
    edge = 0.3 * float(positive.min()) if len(positive) else 1e-6  # where kappa = 0 stands on a logarithmic axis
    models = [name for name in MODEL_ERRORS if name in set(summary["model_error"])]
    margins = (0.79, 0.72, 0.37, 3.0)  # inch; the curves stand below
    figure, maps = style.panels(3, len(models), 1.47, margins=margins, gaps=(0.11, 0.19), sharex=True, sharey=True)
    height = figure.get_figheight()
    for column, model in zip(maps.T, models, strict=True):
        of_model = summary[summary["model_error"] == model]
        for axes, quantity in zip(column, RESPONSE_QUANTITIES, strict=True):
            image = _heat_map(axes, of_model[of_model["quantity"] == quantity])
        place = column[0].get_position()
        curves = figure.add_axes((place.x0, 0.5 / height, place.width, 1.85 / height))
        _against_strength(curves, of_model[of_model["quantity"] == "displacement"], edge)
        curves.tick_params(labelleft=model == models[0])
        column[0].set_title(MODEL_ERRORS[model])
        column[-1].set_xlabel(r"$\kappa$ (N/m$^3$)", labelpad=1)
    for axes, quantity in zip(maps[:, 0], RESPONSE_QUANTITIES, strict=True):
        axes.set_ylabel(f"{quantity} {style.SYMBOLS[quantity]}\nforce rms (N)")
    first = figure.axes[maps.size]
    first.set_ylabel(r"error of $u$, 100 − fitness (%)")
    first.legend(loc="center left", handletextpad=0.2, borderaxespad=0.2)
    first.text(0.98, 100.0, "no better than the mean", transform=first.get_yaxis_transform(), ha="right",
               va="bottom", fontsize=6, color=style.GREY)  # fmt: skip
    bar: Any = figure.colorbar(image, cax=maps[1, -1].inset_axes((1.06, -0.5, 0.06, 2.0)), extend="both")
    bar.set_label("our error, 100 − fitness (%)")
    bar.outline.set_linewidth(0.4)
    bar.ax.set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    return figure


def _heat_map(axes: Axes, cells: pd.DataFrame) -> AxesImage:
    """Fitness in percent: rows by force, columns by kappa; ours and below it the smoother's."""
    table = cells.pivot_table(index="force_rms", columns=["estimator", "kappa"], values="fitness_percent")
    kappas = sorted(set(cells["kappa"]))
    ours, smoothed = (
        table.reindex(columns=[(name, kappa) for kappa in kappas]).to_numpy() for name in (PINN, SMOOTHER.name)
    )
    error, norm = np.clip(100.0 - ours, _SMALLEST, _LARGEST), LogNorm(_SMALLEST, _LARGEST)
    image = axes.imshow(
        error, cmap=colormaps["viridis_r"], interpolation="nearest", origin="lower", norm=norm, aspect="auto"
    )
    for (row, column), value in np.ndenumerate(ours):
        if np.isfinite(value):
            ink: style.Look = {"ha": "center", "va": "center", "color": "white" if 100.0 - value > _DARK else "black"}
            axes.text(column, row + 0.12, _percent(value), fontsize=7, **ink)
            axes.text(column, row - 0.27, _percent(float(smoothed[row, column])), fontsize=5, **ink)
    axes.set_xticks(range(len(kappas)), [f"{value:g}" for value in kappas])
    axes.set_yticks(range(len(table)), [f"{value:g}" for value in table.index])
    axes.tick_params(length=0)
    return image


def _percent(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f}" if value > 99.0 else f"{value:.1f}" if value > 0.0 else "< 0"


def _against_strength(axes: Axes, cells: pd.DataFrame, edge: float) -> None:
    ours: dict[str, Any] = {"marker": "o", "ms": 3.4, "mfc": style.BLUE, "mec": style.BLUE}
    smoother: dict[str, Any] = {"marker": "s", "ms": 4.4, "mfc": "none", "mec": style.VERMILLION}
    for estimator, title, look in ((PINN, "ours", ours), (SMOOTHER.name, SMOOTHER.title, smoother)):
        of = cells[cells["estimator"] == estimator]
        place = of["strength"].where(of["strength"] > 0.0, edge)
        axes.plot(place, 100.0 - of["fitness_percent"], linestyle="none", markeredgewidth=0.7, label=title, **look)
    axes.set(xscale="log", yscale="log", xlim=(0.5 * edge, 20.0), ylim=(0.02, 2000.0))
    axes.set_xlabel(r"strength $\kappa\,\langle e^2\rangle/k$")
    axes.axhline(100.0, color=style.GREY, linewidth=0.6, linestyle=":")
    axes.grid(True, which="major")
    axes.set_axisbelow(True)
