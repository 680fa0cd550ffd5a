"""A search in one figure: the score of every trial, and against every setting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = 3
# Numbers that span more than this factor stand on a logarithmic axis.
WIDE = 10.0
MOST_TICKS = 5


def search_figure(trials: pd.DataFrame, settings: Sequence[str], importances: dict[str, float]) -> Figure:
    """Draw the trials that have a score.

    Args:
        trials: Of :func:`pinn_cli.sweep.search_trials.trials_table`; at least one has a score.
        settings: Its columns that were searched.
        importances: By setting, NaN where unknown.
    """
    done = trials[trials["score"].notna()]
    above = done["score"] - done["score"].min()
    rows = math.ceil(len(settings) / COLUMNS)
    with style.look():
        figure = Figure(figsize=(style.PAGE_WIDTH, 2.1 + 1.75 * rows), layout="constrained")
        grid = figure.add_gridspec(1 + rows, COLUMNS)
        history = figure.add_subplot(grid[0, :])
        _history(history, trials, done["trial"], above)
        for index, setting in enumerate(settings):
            axes = figure.add_subplot(grid[1 + index // COLUMNS, index % COLUMNS])
            _slice(axes, done[setting], above, setting, importances[setting])
            _scale(axes, above)
            if index % COLUMNS:
                axes.tick_params(labelleft=False)
            else:
                axes.set_ylabel("above the best (nats)")
        _scale(history, above)
    return figure


def _history(axes: Axes, trials: pd.DataFrame, number: pd.Series, above: pd.Series) -> None:
    axes.plot(number, above, "o", markersize=3, color=style.BLUE, label="trial")
    axes.step(number, np.minimum.accumulate(above), where="post", color=style.VERMILLION, label="best so far")
    for failed in trials.loc[trials["state"] == "failed", "trial"]:
        axes.axvline(failed, color=style.GREY, linewidth=0.8, linestyle=":")
    if (trials["state"] == "failed").any():
        axes.plot([], [], color=style.GREY, linewidth=0.8, linestyle=":", label="failed")
    axes.set(xlabel="trial", ylabel="score above\nthe best (nats)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="upper right", ncols=3)


def _slice(axes: Axes, values: pd.Series, above: pd.Series, setting: str, share: float) -> None:
    numbers = pd.to_numeric(values, errors="coerce")
    if numbers.notna().all() and values.nunique() > 2:
        axes.plot(numbers, above, "o", markersize=3, color=style.BLUE)
        if numbers.min() > 0 and numbers.max() > WIDE * numbers.min():
            axes.set_xscale("log")
        best = float(numbers.iloc[int(above.argmin())])
    else:
        names = sorted(set(values.astype(str)))
        place = values.astype(str).map(names.index)
        # Side by side in the order of the trials, so that equal ones do not hide each other.
        spread = np.linspace(-0.25, 0.25, len(place)) if len(place) > 1 else np.zeros(1)
        axes.plot(place + spread, above, "o", markersize=3, color=style.BLUE)
        axes.set_xticks(range(len(names)), names)
        axes.set_xlim(-0.6, len(names) - 0.4)
        best = float((place + spread).iloc[int(above.argmin())])
    axes.plot([best], [0.0], "o", markersize=6, markerfacecolor="none", color=style.VERMILLION)
    explained = "" if math.isnan(share) else f"\nexplains {100 * share:.0f} %"
    axes.set_title(f"{setting}{explained}", fontsize=7)


def _scale(axes: Axes, above: pd.Series) -> None:
    """Linear next to the best, logarithmic far from it: bad trials are bad by orders of magnitude."""
    positive = above[above > 0]
    if len(positive) == 0:
        return
    linear = max(float(positive.quantile(0.1)), 1e-12)
    axes.set_yscale("symlog", linthresh=linear)
    axes.set_ylim(-0.3 * linear, 2.0 * float(above.max()) + linear)
    decades = 10.0 ** np.arange(math.floor(math.log10(linear)), math.ceil(math.log10(float(above.max()))) + 1)
    ticks = [t for t in np.outer(decades, (1, 2, 5)).ravel() if linear <= t <= float(above.max())]
    ticks = [t for t in decades if t in ticks] if len(ticks) > MOST_TICKS else ticks
    ticks = ticks[:: math.ceil(len(ticks) / MOST_TICKS)] if ticks else ticks
    axes.set_yticks([0.0, *ticks], ["0", *(f"{t:g}" for t in ticks)])
    axes.minorticks_off()
