"""The measured force against its posterior predictive distribution."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.report.figures.response import periods_of, shown_dofs
from pinn_cli.training.central_interval import CENTRAL_90

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.posterior.result import ForcePredictive
    from pinn_cli.record.record import Record

PERIODS_SHOWN = 10

_DOTS: dict[str, Any] = {**style.DOTS, "color": style.BLACK, "zorder": 2.2}
_MEDIAN: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.9, "zorder": 2.1}
_BAND: dict[str, Any] = {"color": style.VERMILLION, "alpha": 0.25, "linewidth": 0, "zorder": 1.9}


def force_predictive_figure(predictive: ForcePredictive, record: Record, dofs: np.ndarray) -> Figure:
    """One row per measured force: observed dots, predictive median and central 90 % band, on a stretch of the record.

    What share of the observations lies in the band, at all times that were predicted, is written in each panel: about
    90 % if model and noise are right.

    Args:
        predictive: Draws of F forces, (chains, draws, times, F).
        record: What was measured.
        dofs: (F,), their DOFs, counted from 1. Of many, as many rows are drawn as the response has.
    """
    time = record.time[predictive.samples]
    observed = record.force[np.ix_(predictive.samples, dofs - 1)]
    lower, median, upper = np.quantile(predictive.force, (CENTRAL_90[0], 0.5, CENTRAL_90[1]), axis=(0, 1))
    held = np.mean((observed >= lower) & (observed <= upper), axis=0)
    rows = shown_dofs(len(dofs))
    window = predictive_window(median[:, rows])
    factor, prefix = style.unit_prefix(float(np.max(np.abs(observed), initial=0.0)), kilo=True)
    with style.look():
        figure, grid = style.panels(len(rows), 1, 1.25, margins=(0.55, 0.1, 0.32, 0.4), gaps=(0.0, 0.12), sharex=True)
        panels = grid[:, 0]
        for panel, row in zip(panels, rows, strict=True):
            lines = (factor * line[window, row] for line in (observed, lower, median, upper))
            _draw(panel, time[window], *lines)
            panel.set_ylabel(
                f"DOF {record.dof_name(dofs[row] - 1)}: {style.SYMBOLS['force']} ({style.unit('force', prefix)})"
            )
            share = f"band holds {100.0 * held[row]:.0f} % of the observations"
            panel.text(0.995, 0.96, share, transform=panel.transAxes, ha="right", va="top", fontsize=7)
        panels[-1].set_xlabel(r"Time $t$ (s)")
        figure.align_ylabels(list(panels))
        handles = [
            Line2D([], [], label="observed", **{**_DOTS, "markersize": 6}),
            Line2D([], [], label="predictive median", **_MEDIAN),
            Patch(label="90 % band", **_BAND),
        ]
        figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
    return figure


def predictive_window(force: np.ndarray) -> slice:
    """About `PERIODS_SHOWN` periods from the middle of the record, or all of it if it has no more.

    A period is twice the mean distance of changes of sign.

    Args:
        force: (times, F).
    """
    count, periods = len(force), periods_of(force)
    if periods <= PERIODS_SHOWN:
        return slice(0, count)
    half = max(round(count * PERIODS_SHOWN / periods / 2.0), 5)
    return slice(max(count // 2 - half, 0), count // 2 + half + 1)


def _draw(
    panel: Axes, time: np.ndarray, observed: np.ndarray, lower: np.ndarray, median: np.ndarray, upper: np.ndarray
) -> None:
    panel.fill_between(time, lower, upper, **_BAND)
    panel.plot(time, median, **_MEDIAN)
    panel.plot(time, observed, **_DOTS)
    highest, lowest = max(observed.max(), upper.max()), min(observed.min(), lower.min())
    margin = 0.05 * (highest - lowest) or 1.0
    panel.set_ylim(lowest - margin, highest + 4.0 * margin)  # room for the text above
    panel.set_xlim(time[0], time[-1])
    panel.yaxis.set_major_locator(MaxNLocator(5))
