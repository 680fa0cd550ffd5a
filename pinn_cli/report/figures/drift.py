"""Drifts of the connections: their histories, and their peaks one above the other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.report.figures.decimate import line_indices
from pinn_cli.report.figures.response import PERIODS_IN_FULL, PERIODS_SHOWN, periods_of
from pinn_cli.training.central_interval import HALF_WIDTH_90

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.report.drift import Drifts

ROWS_IN_FULL = 8  # more connections than these: those with the largest peaks
BAND = 1.96  # standard deviations to either side of the estimate: 95 %

_TRUE: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.0, "zorder": 2.0}
_ESTIMATE: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.8, "linestyle": (0, (2.5, 1.2)), "zorder": 2.2}
_BAND: dict[str, Any] = {"color": style.VERMILLION, "alpha": 0.3, "linewidth": 0, "zorder": 1.9}
_PEAK: dict[str, Any] = {"color": style.VERMILLION, "linestyle": "none", "marker": "o", "markersize": 3.5}
_TRUE_PEAK: dict[str, Any] = {"color": style.BLACK, "linestyle": "none", "marker": "|", "markersize": 9.0}


def drift_figure(drifts: Drifts, truth_label: str = "truth") -> Figure:
    """A row for each connection, its drift over time with its 95 % band; on the right the peaks with 90 % intervals.

    Of more than `ROWS_IN_FULL` connections the histories of those with the largest peaks are shown; the peaks of all.
    Of a record with too many periods, the histories about the largest of all peaks.

    Args:
        drifts: Of the estimate.
        truth_label: What the legend calls the truth, which is drawn where it is known.
    """
    peaks = drifts.peak(drifts.estimate)[0]
    shown = np.sort(np.argsort(-peaks, kind="stable")[:ROWS_IN_FULL])
    factor, prefix = style.unit_prefix(float(peaks.max(initial=0.0)))
    with style.look():
        figure, panels = style.panels(
            len(shown), 2, 0.75, margins=(0.75, 0.08, 0.5, 0.42), gaps=(0.75, 0.12), width_ratios=(2.4, 1.0)
        )
        window = _window(drifts)
        for axes, connection in zip(panels[:, 0], shown, strict=True):
            _draw_history(axes, drifts, connection, window, factor)
            axes.tick_params(labelbottom=connection == shown[-1])
        panels[-1, 0].set_xlabel(r"Time $t$ (s)", labelpad=2)
        panels[0, 0].set_title(f"Drift ({style.unit('displacement', prefix)})", pad=4)
        figure.align_ylabels(list(panels[:, 0]))
        _draw_peaks(_merged(figure, panels[:, 1]), drifts, factor, prefix)
        _legend(figure, drifts, truth_label)
        if len(shown) < len(drifts.names):
            note = f"histories: the {len(shown)} of {len(drifts.names)} connections with the largest peaks"
            figure.text(0.01, 0.002, note, ha="left", va="bottom", fontsize=7)
    return figure


def _window(drifts: Drifts) -> slice:
    """The samples whose histories are drawn."""
    samples, rate = len(drifts.time), np.diff(drifts.estimate, axis=0)
    periods = periods_of(rate)
    if periods <= PERIODS_IN_FULL:
        return slice(0, samples)
    half = int(samples * PERIODS_SHOWN / periods / 2.0)
    highest = int(np.argmax(np.max(np.abs(drifts.estimate), axis=1)))
    middle = min(max(highest, half), samples - 1 - half)
    return slice(middle - half, middle + half + 1)


def _title(name: str) -> str:
    """A number alone would not say what it counts."""
    return f"connection {name}" if name.isdecimal() else name


def _merged(figure: Figure, column: np.ndarray) -> Axes:
    """One panel in the place of a column of them."""
    top, bottom = column[0].get_position(), column[-1].get_position()
    for axes in column:
        axes.remove()
    return figure.add_axes((bottom.x0, bottom.y0, top.width, top.y1 - bottom.y0))


def _draw_history(axes: Axes, drifts: Drifts, connection: int, window: slice, factor: float) -> None:
    time, estimate = drifts.time[window], factor * drifts.estimate[window, connection]
    true, spread = factor * drifts.true[window, connection], BAND * factor * drifts.std[window, connection]
    kept = line_indices(estimate)
    if np.isfinite(true).all():
        places = line_indices(true)
        axes.plot(time[places], true[places], **_TRUE)
    if np.isfinite(spread).all():
        axes.fill_between(time[kept], (estimate - spread)[kept], (estimate + spread)[kept], **_BAND)
    axes.plot(time[kept], estimate[kept], **_ESTIMATE)
    at = int(drifts.peak(drifts.estimate)[1][connection])
    axes.plot(drifts.time[at], factor * drifts.estimate[at, connection], **_PEAK)
    axes.set_xlim(time[0], time[-1])
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))
    axes.set_ylabel(_title(drifts.names[connection]))


def _draw_peaks(axes: Axes, drifts: Drifts, factor: float, prefix: str) -> None:
    """The first connection lowest, as the storeys of a building are."""
    peaks, sample = drifts.peak(drifts.estimate)
    place = np.arange(len(peaks))
    half = HALF_WIDTH_90 * drifts.std[sample, place]
    if np.isfinite(half).all():
        left = np.maximum(peaks - half, 0.0)
        axes.hlines(place, factor * left, factor * (peaks + half), color=style.VERMILLION, linewidth=1.2)
    true = drifts.peak(drifts.true)[0]
    axes.plot(factor * peaks, place, **_PEAK)
    axes.plot(factor * true, place, **_TRUE_PEAK)
    axes.set_xlim(left=0.0)
    axes.set_ylim(-0.6, len(peaks) - 0.4)
    few = place if len(place) <= 2 * ROWS_IN_FULL else place[:: -(-len(place) // ROWS_IN_FULL)]
    axes.set_yticks(few, [drifts.names[i] for i in few])
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.set_xlabel(f"Peak drift ({style.unit('displacement', prefix)})", labelpad=2)


def _legend(figure: Figure, drifts: Drifts, truth_label: str) -> None:
    handles: list[Line2D | Patch] = []
    if np.isfinite(drifts.true).any():
        handles.append(Line2D([], [], label=truth_label, **_TRUE))
    handles.append(Line2D([], [], label="estimate", **_ESTIMATE))
    peak = "peak"
    if np.isfinite(drifts.std).all():
        handles.append(Patch(label="95 % band", **_BAND))
        peak = "peak, 90 % interval"
    handles.append(Line2D([], [], label=peak, **_PEAK))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
