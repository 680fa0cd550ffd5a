"""Parameters from record to record."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.training.central_interval import HALF_WIDTH_90

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS, MOST = 3, 24

_ESTIMATE: dict[str, Any] = {"color": style.BLUE, "linewidth": 1.0, "marker": "o", "markersize": 2.5}
_BAND: dict[str, Any] = {"color": style.BLUE, "alpha": 0.25, "linewidth": 0}
_ALONE: dict[str, Any] = {"color": style.GREY, "linestyle": "none", "marker": ".", "markersize": 3.0, "elinewidth": 0.6}
_CHANGE: dict[str, Any] = {"color": style.VERMILLION, "linestyle": (0, (3, 2)), "linewidth": 1.0}


def over_time_figure(table: pd.DataFrame) -> Figure:
    """A panel for every parameter: its estimate after each record with its 90 % band, and what the record says alone.

    Of more than `MOST` parameters those that changed are shown, and those that are known best.

    Args:
        table: From `pinn_cli.report.over_time.parameters_over_time`.
    """
    names = _shown(table)
    rows = -(-len(names) // COLUMNS)
    with style.look():
        figure, panels = style.panels(rows, COLUMNS, 1.05, margins=(0.6, 0.08, 0.45, 0.4), gaps=(0.6, 0.32))
        for axes in panels.flat[len(names) :]:
            axes.remove()
        for axes, name in zip(panels.flat, names, strict=False):
            _draw(axes, table[table["parameter"] == name], name)
        for axes in panels[-1]:
            axes.set_xlabel("Record", labelpad=2)
        figure.legend(
            handles=[
                Line2D([], [], label="after the record", **_ESTIMATE),
                Patch(label="90 % band", **_BAND),
                Line2D([], [], label="by the record alone", color=style.GREY, linestyle="none", marker="."),
                Line2D([], [], label="changed", **_CHANGE),
            ],
            loc="upper center",
            bbox_to_anchor=(0.5, 1.0),
            ncols=4,
        )
    return figure


def _shown(table: pd.DataFrame) -> list[str]:
    names = list(dict.fromkeys(table["parameter"]))
    if len(names) <= MOST:
        return names
    last = table[table["record"] == table["record"].max()].set_index("parameter")
    relative = (last["std"] / last["estimate"].abs()).replace(np.nan, np.inf)
    changed = set(table.loc[table["changed"], "parameter"])
    best = sorted(names, key=lambda name: (name not in changed, relative.get(name, np.inf)))[:MOST]
    return [name for name in names if name in best]


def _draw(axes: Axes, own: pd.DataFrame, name: str) -> None:
    factor, prefix = style.unit_prefix(float(own["estimate"].abs().max()), kilo=True)
    record, unit = own["record"].to_numpy(), str(own["unit"].iloc[-1]) if own["unit"].notna().all() else ""
    axes.fill_between(record, factor * own["lower_90"], factor * own["upper_90"], **_BAND)
    axes.plot(record, factor * own["estimate"], **_ESTIMATE)
    low, high = axes.get_ylim()
    half = HALF_WIDTH_90 * own["alone_std"].to_numpy()
    axes.errorbar(record + 0.12, factor * own["alone"].to_numpy(), factor * half, **_ALONE)
    reach = np.clip(factor * own["alone"].to_numpy(), low - 2 * (high - low), high + 2 * (high - low))
    spread = reach[np.isfinite(reach)]
    margin = 0.1 * (high - low)
    axes.set_ylim(min(low, spread.min(initial=low)) - margin, max(high, spread.max(initial=high)) + margin)
    for at in own.loc[own["changed"].astype(bool), "record"]:
        axes.axvline(at - 0.5, **_CHANGE)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.set_title(f"{name} ({prefix}{style.raised(unit)})" if unit else name, pad=3)
