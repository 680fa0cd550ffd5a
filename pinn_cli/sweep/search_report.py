"""What a search leaves behind: search.csv, search.md and a figure."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.runs.writing import write_table, write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TABLE, TEXT, FIGURE = "search.csv", "search.md", "search"
LEADING = ("trial", "state", "score", "seconds", "directory", "reason")
BEST_SHOWN = 10
# Fewer trials than this say nothing about a setting.
FEWEST_TRIALS = 5
# Of panels. Numbers that span more than a factor stand on a logarithmic axis.
PANELS_IN_A_ROW, WIDE = 3, 10.0


def write_trials(trials: pd.DataFrame, directory: Path) -> None:
    """Write `search.csv`: a row per trial that has ended, `LEADING` and the settings that were searched."""
    write_table(trials, directory / TABLE)


def report_search(trials: pd.DataFrame, command: str, directory: Path) -> str:
    """Write the report of a search.

    Args:
        trials: As `search.csv` has them; at least one has a score.
        command: That makes a run with the settings of the best.
        directory: Of the search.

    Returns:
        The best settings as a command, in a line or two for the terminal.
    """
    done = trials[trials["score"].notna()]
    shares = {name: importance(done[name], done["score"]) for name in trials.columns if name not in LEADING}
    style.save(search_figure(trials, shares), directory, FIGURE)
    write_text(_text(trials, shares, command), directory / TEXT)
    best = done.iloc[int(done["score"].argmin())]
    return f"best of {len(done)} trials: score {best['score']:.5g} (trial {best['trial']}), with\n{command}"


def importance(values: pd.Series, score: pd.Series) -> float:
    """Share of the variance of the scores' ranks that a setting explains by itself, 0 to 1, adjusted for its freedom.

    A parabola in the ranks of a number, the group means of a choice; NaN with too few trials or a single value. Trials
    of a search crowd where it is good, so this ranks settings within a search and is no property of the estimator.
    """
    ranks = score.rank().to_numpy(float)
    numbers = pd.to_numeric(values, errors="coerce")
    if numbers.notna().all() and numbers.nunique() > 2:
        x = numbers.rank().to_numpy(float)
        design = np.vander((x - x.mean()) / x.std(), 3)
    else:
        design = pd.get_dummies(values.astype(str)).to_numpy(float)
    freedom = len(ranks) - design.shape[1]
    if len(ranks) < FEWEST_TRIALS or freedom < 1 or values.astype(str).nunique() < 2 or np.ptp(ranks) == 0:
        return float("nan")
    rest = ranks - design @ np.linalg.lstsq(design, ranks, rcond=None)[0]
    return float(max(0.0, 1.0 - (rest @ rest / freedom) / np.var(ranks, ddof=1)))


def _text(trials: pd.DataFrame, shares: Mapping[str, float], command: str) -> str:
    done, failed, first = trials[trials["score"].notna()], trials[trials["state"] == "failed"], trials.iloc[0]
    best = done.sort_values("score").head(BEST_SHOWN)
    shown = best[["trial"]].assign(score=best["score"].map("{:.5g}".format), s=best["seconds"].map("{:.1f}".format))
    for name in shares:
        shown[name] = best[name].map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)
    explained = pd.Series(shares, dtype=float).sort_values(ascending=False, kind="stable")
    percent = [f"{100 * share:.0f} %" if share == share else "-" for share in explained]
    as_configured = f"Trial 0, with the settings as configured where the search may choose them: {first['score']:.5g}."
    counted = f"{len(trials)} trials, {len(done)} with a score, {len(failed)} failed"
    counted += f"; {trials['seconds'].sum():.0f} s of runs in all. Lower is better."
    lines = [
        "# Search", "",
        counted, "",
        *([as_configured, ""] if first["state"] == "done" else []),
        "The best settings:", "", "```", command, "```", "",
        f"![Score of every trial, and against every setting]({FIGURE}.png)", "",
        "How much of the ranks of the scores each setting explains by itself:", "",
        *_markdown(pd.DataFrame({"setting": [f"`{name}`" for name in explained.index], "share": percent})), "",
        f"The best {len(best)} trials:", "",
        *_markdown(shown),
    ]  # fmt: skip
    if len(failed):
        lines += ["", "Failed:", "", *_markdown(failed[["trial", "reason"]].fillna(""))]
    return "\n".join(lines)


def _markdown(table: pd.DataFrame) -> list[str]:
    rows = [table.columns, ["---"] * table.shape[1], *table.astype(object).to_numpy()]
    lines = ([re.sub(r"[|\n]", " ", str(cell)) for cell in row] for row in rows)
    return [f"| {' | '.join(cells)} |" for cells in lines]


def search_figure(trials: pd.DataFrame, importances: Mapping[str, float]) -> Figure:
    """Draw the score of every trial that has one above the best, in the order of the trials and against every setting.

    Args:
        trials: As `search.csv` has them; at least one has a score.
        importances: By searched setting, NaN where unknown.
    """
    done = trials[trials["score"].notna()]
    above = done["score"] - done["score"].min()
    rows = math.ceil(len(importances) / PANELS_IN_A_ROW)
    with style.look():
        figure = Figure(figsize=(style.PAGE_WIDTH, 2.1 + 1.75 * rows), layout="constrained")
        grid = figure.add_gridspec(1 + rows, PANELS_IN_A_ROW)
        history = figure.add_subplot(grid[0, :])
        _history(history, trials, done["trial"], above)
        for index, (setting, share) in enumerate(importances.items()):
            axes = figure.add_subplot(grid[1 + index // PANELS_IN_A_ROW, index % PANELS_IN_A_ROW], sharey=history)
            _slice(axes, done[setting], above)
            axes.set_title(setting if math.isnan(share) else f"{setting}\nexplains {100 * share:.0f} %", fontsize=7)
            axes.tick_params(labelleft=index % PANELS_IN_A_ROW == 0)
            if index % PANELS_IN_A_ROW == 0:
                axes.set_ylabel("above the best (nats)")
        if (above > 0.0).any():  # linear next to the best: bad trials are bad by orders of magnitude
            linear = max(float(above[above > 0.0].quantile(0.1)), 1e-12)
            history.set_yscale("symlog", linthresh=linear)
            history.set_ylim(-0.3 * linear, 2.0 * float(above.max()) + linear)
            history.minorticks_off()
    return figure


def _history(axes: Axes, trials: pd.DataFrame, number: pd.Series, above: pd.Series) -> None:
    axes.plot(number, above, "o", markersize=3, color=style.BLUE, label="trial")
    axes.step(number, np.minimum.accumulate(above), where="post", color=style.VERMILLION, label="best so far")
    for index, failed in enumerate(trials.loc[trials["state"] == "failed", "trial"]):
        axes.axvline(failed, color=style.GREY, linewidth=0.8, linestyle=":", label="" if index else "failed")
    axes.set(xlabel="trial", ylabel="score above\nthe best (nats)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="upper right", ncols=3)


def _slice(axes: Axes, values: pd.Series, above: pd.Series) -> None:
    place = pd.to_numeric(values, errors="coerce")
    if place.notna().all() and values.nunique() > 2:
        if place.min() > 0 and place.max() > WIDE * place.min():
            axes.set_xscale("log")
    else:
        names = sorted(set(values.astype(str)))
        # Side by side in the order of the trials, so that equal ones do not hide each other.
        place = values.astype(str).map(names.index) + np.linspace(-0.25, 0.25, len(values))
        axes.set_xticks(range(len(names)), names)
        axes.set_xlim(-0.6, len(names) - 0.4)
    axes.plot(place, above, "o", markersize=3, color=style.BLUE)
    best = int(above.argmin())
    axes.plot([place.iloc[best]], [0.0], "o", markersize=6, markerfacecolor="none", color=style.VERMILLION)
