"""Absolute error over time and DOF (paper, figure of the 20-DOF case), with the border of the observation domain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.report.figures.decimate import block_maximum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.training.estimate import Estimate


def error_map_figure(estimate: Estimate, record: Record, truth: Response | None) -> Figure:
    """One panel per quantity: |estimate - truth| with time to the right and DOFs downwards.

    Where the truth of a quantity is known at no DOF, its panel shows the estimate's standard deviation and says so; a
    DOF with neither is hatched. A column of pixels shows the largest value of its stretch of time. The dashed red lines
    frame the DOFs with a response sensor.
    """
    with style.look():
        height = min(max(0.16 * record.ndof, 1.2), 2.4)
        figure, panels = style.panels(2, 2, height, margins=(0.45, 0.5, 0.3, 0.5), gaps=(0.95, 0.5))
        for axes, quantity in zip(panels.flat, QUANTITIES, strict=True):
            values, meaning = _mapped(estimate, truth, quantity)
            _draw_map(figure, axes, record, values, quantity, meaning)
            _frame_observed(axes, record)
        for axes in panels[1]:
            axes.set_xlabel(r"Time $t$ (s)")
        for axes in panels[:, 0]:
            axes.set_ylabel("DOF")
        if any(axes.patch.get_hatch() for axes in panels.flat):
            figure.text(0.99, 0.01, "hatched: no truth", ha="right", va="bottom", fontsize=7)
    return figure


def _mapped(estimate: Estimate, truth: Response | None, quantity: str) -> tuple[np.ndarray, str]:
    """What a panel shows, (time, dof), and what that is."""
    if truth is not None:
        error = np.abs(getattr(estimate.response, quantity) - getattr(truth, quantity))
        if np.isfinite(error).any():
            return error, "absolute error"
    return getattr(estimate.std, quantity), "standard deviation, no truth"


def _draw_map(figure: Figure, axes: Axes, record: Record, values: np.ndarray, quantity: str, meaning: str) -> None:
    peak = float(np.nanmax(values, initial=0.0))
    factor, prefix = style.unit_prefix(peak, kilo=quantity == "force")
    if not np.isfinite(values).all():
        axes.patch.set(hatch="////", facecolor="#F2F2F2", edgecolor="#BFBFBF", linewidth=0)
    image = axes.imshow(
        np.ma.masked_invalid(factor * block_maximum(values).T),
        extent=(record.time[0], record.time[-1], record.ndof + 0.5, 0.5),
        aspect="auto",
        interpolation="nearest",
        cmap=colormaps["viridis"],
        vmin=0.0,
        vmax=factor * peak or 1.0,
    )
    bar = figure.colorbar(image, cax=axes.inset_axes((1.025, 0.0, 0.035, 1.0)))
    bar.outline.set_linewidth(0.4)
    bar.locator = MaxNLocator(5)
    axes.set_title(f"{quantity.capitalize()}: {meaning} ({style.unit(quantity, prefix)})", pad=4)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    ticks = _dof_ticks(record.ndof)
    axes.set_yticks(ticks, [record.dof_name(dof - 1) for dof in ticks])
    axes.tick_params(direction="out")


def _dof_ticks(ndof: int) -> list[int]:
    """The first DOF and round numbers, ten labels at most."""
    step = next(step for step in (1, 2, 5, 10, 20, 50, 100, ndof) if ndof / step <= 9)
    return [1, *range(step if step > 1 else 2, ndof + 1, step)]


def _frame_observed(axes: Axes, record: Record) -> None:
    """A dashed red frame around each run of neighbouring DOFs with a sensor, on white to show on dark colours."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], record.observed.astype(int), [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        for colour, width, dashes in (("white", 2.0, "-"), ("red", 1.1, (0, (4, 2)))):
            frame = Rectangle(
                (record.time[0], first + 0.5), record.time[-1] - record.time[0], end - first,
                fill=False, edgecolor=colour, linewidth=width, linestyle=dashes, clip_on=False, zorder=3,
            )  # fmt: skip
            axes.add_patch(frame)
