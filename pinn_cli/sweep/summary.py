"""Mean and spread over the seeds of a sweep, for every setting that it sweeps, as a table and as a figure.

The figure has a column of panels per numeric setting and a row per quantity.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.text import percent
from pinn_cli.runs.writing import write_table
from pinn_cli.sweep.jobs import FAILED, FINISHED, FITNESS, REASON, STATUS

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
