"""What a sweep shows at its end, as tables, texts and figures: fitness by setting, and which models are probable.

Fitness is the mean and spread over the seeds, for every setting that is swept; its figure has a column of panels per
numeric setting and a row per quantity. Models of one record are compared by their evidence.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.text import percent
from pinn_cli.runs.reading import read_table
from pinn_cli.runs.resume import read_record
from pinn_cli.runs.writing import write_table
from pinn_cli.sweep.jobs import FAILED, FINISHED, FITNESS, REASON, STATUS, Job, Sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SUMMARY = "summary.csv"
OVERALL = "all"
SETTINGS_SHOWN = 30
_OF_A_ROW = ("estimator", "group", "quantity")
MOST_LINES = len(style.CYCLE)  # beyond these a line is one of many, and their mean stands out
_LOGARITHMIC = 30.0  # ratio of the largest to the smallest value from which a setting has a logarithmic axis
_FINEST = 1e-3  # errors in per cent below this are drawn at it
_MOST_COLUMNS, _MOST_VALUES_NAMED = 6, 6
_FEW_DECADES = 1e3  # ratio of the ends of an axis up to which 2 and 5 of each decade have a number
_MARKERS = "os^Dv<>"
_LEGENDS_ABREAST = 4  # entries of legends side by side, over all columns of panels

MODELS = "models.csv"
MODEL_COLUMNS = (
    "log_evidence", "log_bayes_factor", "probability", "validation_nmse_percent", "effective_parameters", "unknown",
    "verdict",
)  # fmt: skip
# Swept settings that make another model of the same record.
_OF_MODELS = ("system", "scheme.unknown")
# Behind the best by this much or more a model is out of the question (150 to 1; Kass and Raftery 1995).
DECISIVE = 5.0
_LEAST, _ROW = 0.1, 0.22  # nats, as the least bar is drawn; inch
_NONE = 1e-99  # a probability below this is written as zero


def is_seed(setting: str) -> bool:
    """Whether a setting is the seed of something random, which is averaged over."""
    return re.fullmatch(r"(?:.*[._])?seeds?", setting) is not None


def summarise(fitness: pd.DataFrame, swept: Sequence[str]) -> pd.DataFrame:
    """The fitness by setting, over the seeds.

    Args:
        fitness: The sweep's `fitness.csv`; its swept settings as text.
        swept: Names of the settings that it sweeps, seeds among them.

    Returns:
        A row per swept setting's value, estimator, group of DOFs and quantity, in the order of the sweep: mean and
        standard deviation (over the draws, n - 1; empty for one) of both formulas, how many `seeds` they are over, and
        how many jobs with that setting `failed`. Where there is no truth there is no row.
    """
    settings = [setting for setting in swept if setting in fitness and not is_seed(setting)]
    by = [*settings, *_OF_A_ROW]
    finished = fitness[(fitness[STATUS] == FINISHED) & fitness["fitness_percent"].notna()]
    grouped = finished.groupby(by, sort=False, dropna=False)
    parts = {f"{formula}_{name}": getattr(grouped[formula], name)() for formula in FORMULAS for name in ("mean", "std")}
    table = pd.DataFrame({**parts, "seeds": grouped[FORMULAS[0]].count()}).reset_index()
    failures = fitness[fitness[STATUS] == FAILED]
    if not settings:
        return table.assign(failed=len(failures))
    failed = failures.groupby(settings, sort=False, dropna=False).size().rename("failed").reset_index()
    table = table.merge(failed, on=settings, how="left" if len(table) else "outer")
    return table.assign(failed=table["failed"].fillna(0).astype(int))


def write_summary(directory: Path, swept: Sequence[str]) -> pd.DataFrame | None:
    """Write `summary.csv` and its figure, of the sweep's `fitness.csv`; None where no job has a fitness."""
    if not (directory / FITNESS).is_file():
        return None
    text = dict.fromkeys([*swept, STATUS, REASON], str)
    fitness = pd.read_csv(directory / FITNESS, dtype=text, low_memory=False)
    summary = summarise(fitness, swept) if "fitness_percent" in fitness else pd.DataFrame()
    if summary.empty:
        return None
    write_table(summary, directory / SUMMARY)
    figure = sweep_figure(summary, [setting for setting in swept if setting in summary])
    if figure is not None:
        style.save(figure, directory / "figures", "fitness")
    return summary


def summary_text(summary: pd.DataFrame) -> str:
    """The mean of the printed formula over all DOFs, a row per setting and estimator."""
    overall = summary[summary["group"] == OVERALL]
    settings = [str(name) for name in overall.columns[: list(overall.columns).index("group")]]
    wide = overall.pivot_table(
        index=[*settings, "failed"], columns="quantity", values="fitness_percent_mean", sort=False, dropna=True
    )
    notes = []
    if len(wide) > SETTINGS_SHOWN:
        notes.append(f"the first {SETTINGS_SHOWN} of {len(wide)} settings; all: summary.csv")
        wide = wide.head(SETTINGS_SHOWN)
    text = wide.map(percent).reset_index().to_string(index=False)
    return "\n".join(["mean fitness over all DOFs and seeds, 1 - error / deviation (%)", text, *notes])


def numeric_settings(table: pd.DataFrame, settings: Sequence[str]) -> list[str]:
    """Those settings whose values are numbers, and not all the same one."""
    numbers = {name: pd.to_numeric(table[name], errors="coerce") for name in settings}
    return [name for name, values in numbers.items() if values.notna().all() and len(values.unique()) > 1]


def sweep_figure(summary: pd.DataFrame, settings: Sequence[str]) -> Figure | None:
    """Mean fitness over the seeds by the printed formula, over all DOFs, with its standard deviation as bars.

    Drawn is the error, 100 less the fitness: on its logarithmic axis 99.9 is as far from 99 as 99 is from 90.

    Args:
        summary: Of :func:`summarise`.
        settings: The swept settings among its columns. Each numeric one has a column; all others tell the lines apart.

    Returns:
        None if no setting is numeric.
    """
    overall = summary[summary["group"] == OVERALL]
    numeric = numeric_settings(overall, settings)[:_MOST_COLUMNS]
    quantities = [quantity for quantity in QUANTITIES if quantity in set(overall["quantity"])]
    if not numeric or not quantities:
        return None
    with style.look():
        figure = Figure(figsize=(style.PAGE_WIDTH, 1.2 + 1.35 * len(quantities)), layout="constrained")
        panels = figure.subplots(len(quantities), len(numeric), sharex="col", sharey="row", squeeze=False)
        for column, setting in zip(panels.T, numeric, strict=True):
            lines = _lines(overall, setting, ["estimator", *(name for name in settings if name != setting)])
            for axes, quantity in zip(column, quantities, strict=True):
                _draw(axes, [(label, rows[rows["quantity"] == quantity]) for label, rows in lines])
            values = np.unique(pd.to_numeric(overall[setting]))
            column[-1].set_xscale("log" if values[0] > 0.0 and values[-1] > _LOGARITHMIC * values[0] else "linear")
            if len(values) <= _MOST_VALUES_NAMED:
                column[-1].set_xticks(values, [f"{value:g}" for value in values], minor=False)
                column[-1].minorticks_off()
            column[-1].set_xlabel(setting)
            if any(column[0].get_legend_handles_labels()[1]):
                abreast = max(1, _LEGENDS_ABREAST // len(numeric))
                column[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=6.5, ncols=abreast)
        for row, quantity in zip(panels, quantities, strict=True):
            row[0].set_yscale("log")
            low, high = row[0].get_ylim()
            # A decade or two hold one power of ten, or none.
            between = LogLocator(subs=(1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,), numticks=8)
            row[0].yaxis.set_major_locator(MaxNLocator(4) if high < 5.0 * low else between)
            row[0].yaxis.set_major_formatter("{x:g}")
            row[0].yaxis.set_minor_locator(NullLocator())
            row[0].set_ylabel(f"100 - fitness of {style.SYMBOLS[quantity]} (%)")
            for axes in row:
                axes.grid(True, axis="y")
                axes.set_axisbelow(True)
    return figure


def _lines(overall: pd.DataFrame, setting: str, others: Sequence[str]) -> list[tuple[str, pd.DataFrame]]:
    """What is drawn against a setting: a label and the rows of the line, for each combination of the others."""
    varied = [name for name in others if len(overall[name].unique()) > 1]
    rows = overall.assign(x=pd.to_numeric(overall[setting])).sort_values("x", kind="stable")
    rows["error"] = (100.0 - rows["fitness_percent_mean"]).clip(lower=_FINEST)
    if not varied:
        return [("", rows)]
    names = [name.rpartition(".")[2] for name in varied]
    return [
        (style.literal(", ".join(f"{short} {value}" for short, value in zip(names, values, strict=True))), part)
        for values, part in rows.groupby(varied, sort=False, dropna=False)
    ]


def _draw(axes: Axes, lines: Sequence[tuple[str, pd.DataFrame]]) -> None:
    if len(lines) > MOST_LINES:
        for _, rows in lines:
            axes.plot(rows["x"], rows["error"], color=style.GREY, linewidth=0.4, alpha=0.6)
        median = pd.concat([rows for _, rows in lines]).groupby("x")["error"].median()
        label = f"median of {len(lines)} other settings"
        axes.plot(median.index, median, color=style.BLUE, marker="o", markersize=2.6, linewidth=1.4, label=label)
        return
    for (label, rows), colour, marker in zip(lines, cycle(style.CYCLE), cycle(_MARKERS)):
        error, spread = rows["error"].to_numpy(), rows["fitness_percent_std"].fillna(0.0).to_numpy()
        below = np.maximum(error - spread, _FINEST)
        axes.errorbar(
            rows["x"].to_numpy(), error, yerr=(error - below, spread), color=colour, marker=marker, markersize=2.6,
            linewidth=0.8, elinewidth=0.6, capsize=1.5, label=label,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Comparison:
    """The models of a sweep.

    Attributes:
        settings: That tell the models apart.
        table: See :func:`compared`; None where they cannot be compared.
        reason: Why not; "" where they are.
    """

    settings: tuple[str, ...]
    table: pd.DataFrame | None
    reason: str = ""


def compared(sweep: Sweep, jobs: Sequence[Job]) -> Comparison | None:
    """Compare the models that the jobs of a sweep differ in; None where they differ in no model.

    Returns:
        A row for each finished job, the most probable first: its swept settings, ``log_evidence`` (natural logarithm of
        the density of all sensors' samples), ``log_bayes_factor`` (that less the greatest), ``probability`` (all models
        being as probable beforehand), ``validation_nmse_percent`` (the free run on ``data.validation``, mean over the
        sensors; empty without), ``effective_parameters`` (how many the record determines beyond their priors) of so
        many ``unknown`` and believed ones, and ``verdict``. Jobs that differ in other settings too are compared with
        those that share these.
    """
    swept = list(dict.fromkeys(name for job in jobs for name in sweep.columns(job)))
    settings = tuple(name for name in swept if name in _OF_MODELS or name.startswith("system."))
    if not settings or sweep.is_search:
        return None
    rows = [sweep.columns(job) | _model_row(job.directory) for job in jobs if job.status == FINISHED]
    models = pd.DataFrame(rows, columns=[*swept, "observed", *MODEL_COLUMNS])
    others = [name for name in swept if name not in settings]
    groups = [group for _, group in models.groupby(others, sort=False, dropna=False)] if others else [models]
    tables = []
    for group in groups:
        if len(group) < 2:
            continue
        reason = _incomparable(group, settings)
        if reason:
            return Comparison(settings, None, reason)
        factor = group["log_evidence"] - group["log_evidence"].max()
        odds = np.exp(factor)
        table = group.assign(log_bayes_factor=factor, probability=odds / odds.sum()).drop(columns="observed")
        tables.append(table.sort_values("log_evidence", ascending=False, kind="stable"))
    if not tables:
        return Comparison(settings, None, "fewer than two of them have finished")
    return Comparison(settings, pd.concat(tables, ignore_index=True))


def _model_row(directory: Path) -> dict[str, Any]:
    """What is compared, of a finished job; the parameters are those of its tables."""
    record = read_record(directory)
    evidence = record.get("training", {}).get("model_log_evidence")
    identifiability, parameters, validation = (
        read_table(directory / name) if (directory / name).is_file() else None
        for name in ("identifiability.csv", "parameters.csv", "validation.csv")
    )
    effective, unknown = np.nan, 0
    if identifiability is not None:
        effective = float((1.0 - (identifiability["std"] / identifiability["prior_std"]).clip(upper=1.0) ** 2).sum())
        if parameters is not None:
            unknown = int(parameters[parameters["estimator"] == "pinn"]["start"].notna().sum())
    return {
        "observed": record.get("observed"),
        "log_evidence": np.nan if evidence is None else float(evidence),
        "validation_nmse_percent": np.nan if validation is None else float(validation["nmse_percent"].mean()),
        "effective_parameters": effective,
        "unknown": unknown,
        "verdict": record.get("verdict"),
    }


def _incomparable(group: pd.DataFrame, settings: Sequence[str]) -> str:
    """Why models cannot be compared; "" where they can."""
    named = [
        " ".join(f"{name}={value}" for name, value in row.items() if value == value)
        for row in group[list(settings)].to_dict("records")
    ]
    for name, evidence, observed in zip(named, group["log_evidence"], group["observed"], strict=True):
        if not np.isfinite(evidence):
            return f"{name} has no evidence: it needs scheme=state_parameter or bayesian, and training=gauss_newton"
        if observed is None or observed != group["observed"].iloc[0]:
            return f"{named[0]} and {name} saw different records or sensors"
    return ""


def models_text(comparison: Comparison) -> str:
    """The table as the sweep prints it, or in one line why there is none."""
    if comparison.table is None:
        return f"models are not compared: {comparison.reason}"
    table = comparison.table
    shown = table[[name for name in table.columns if name not in MODEL_COLUMNS]].copy()
    for name, title, form in (
        ("log_evidence", "log evidence", "{:.1f}"),
        ("probability", "probability", "{:.3f}"),
        ("validation_nmse_percent", "validation NMSE (%)", "{:.3g}"),
        ("effective_parameters", "effective parameters", "{:.1f}"),
    ):
        if name != "validation_nmse_percent" or table[name].notna().any():
            shown[title] = table[name].map(form.format)
    shown["verdict"] = table["verdict"].fillna("-")
    return "\n".join(["models by their evidence; all are as probable beforehand", shown.to_string(index=False)])


def write_models(models: Comparison, directory: Path) -> None:
    """Write the table and the figure; where models are not compared, those of an earlier look go."""
    if models.table is None:
        (directory / MODELS).unlink(missing_ok=True)
        return
    write_table(models.table, directory / MODELS)
    style.save(models_figure(models.table, models.settings), directory / "figures", "models")


def models_figure(table: pd.DataFrame, settings: Sequence[str]) -> Figure:
    """A bar for each model of :func:`compared`, which the settings tell apart.

    Left: the logarithm of the Bayes factor against the most probable model of the same other settings, on a logarithmic
    axis; the shaded part is open. Right: the normalised mean square error of the free run, where there is validation
    data.
    """
    validated = bool(table["validation_nmse_percent"].notna().any())
    with style.look():
        size = (style.PAGE_WIDTH if validated else 4.6, 0.75 + _ROW * len(table))
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(1, 1 + validated, squeeze=False, sharey=True)[0]
        place = np.arange(len(table))[::-1]
        _draw_evidence(panels[0], table, place)
        panels[0].set_yticks(place, [_label(row, settings) for _, row in table.iterrows()])
        if validated:
            panels[1].barh(place, table["validation_nmse_percent"], color=style.GREY, height=0.6)
            panels[1].set_xscale("log")
            panels[1].set_xlabel("free run on validation data, NMSE (%)")
    return figure


def _draw_evidence(axes: Axes, table: pd.DataFrame, place: np.ndarray) -> None:
    behind = -table["log_bayes_factor"].to_numpy()
    axes.axvspan(_LEAST, DECISIVE, color=style.SKY, alpha=0.25, linewidth=0)
    axes.barh(place, np.maximum(behind, _LEAST) - _LEAST, left=_LEAST, color=style.BLUE, height=0.6)
    axes.set_xscale("log")
    axes.set_xlim(_LEAST, max(20.0 * behind.max(), 10.0 * DECISIVE))
    for y, end, probability in zip(place, np.maximum(behind, _LEAST), table["probability"], strict=True):
        shown = f"p = {probability:.2g}" if probability > _NONE else "p = 0"
        axes.annotate(shown, (end, y), xytext=(3, 0), textcoords="offset points", va="center",
                      fontsize=6.5, color=style.BLACK)  # fmt: skip
    axes.set_xlabel("behind the most probable model (nats), and probability p")


def _label(row: pd.Series, settings: Sequence[str]) -> str:
    others = [name for name in row.index[: list(row.index).index("log_evidence")] if name not in settings]
    values = [str(row[name]) for name in (*settings, *others) if name in row and row[name] == row[name]]
    return style.literal(", ".join(values))
