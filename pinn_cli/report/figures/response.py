"""Motion and force of the DOFs: the layout of the paper's Figures 4 to 8, and the map of their errors."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.report.estimates import Histories, dof_histories, ground_history
from pinn_cli.report.figures import histories, style
from pinn_cli.report.results import Results
from pinn_cli.training.estimate import Estimate

ROWS_IN_FULL = 6  # more DOFs than these: the first two and the last two, as in the paper


def response_figure(results: Results) -> Figure:
    """Rows are DOFs, an asterisk marks those without a response sensor; columns are u, its two time derivatives, and f.

    Drawn are the estimate with its band of 95 %, the truth where it is known, observations as points (at most `POINTS`
    of a channel), the true response of the equivalent linear system, and that of the baseline. Where the ground moves,
    its acceleration stands in a last row. The force has one scale for all DOFs, so that an estimated force where there
    is none is seen in proportion; its root mean square is written there. Of a record with too many periods, the middle.
    """
    record, run = results.record, results.run
    rows, window = shown_dofs(record.ndof), shown_window(record.time, results.estimate.response)
    ground = ground_history(results)
    shaken = ground is not None and record.ground_acceleration is not None
    every = histories.thinned(len(record.time[window]))
    seen = "observations" + (f" (one in {every} shown)" if every > 1 else "")
    looks = histories.looks(true=run.truth_label, baseline=run.baseline.replace("_", " "), observed=seen)
    with style.look():
        margins = (0.62, 0.08, 0.48, 0.46)
        figure, panels = style.panels(len(rows) + shaken, len(QUANTITIES), 0.645, margins=margins, gaps=(0.36, 0.077))
        for column, each in enumerate(dof_histories(results)):
            histories.draw_column(panels[: len(rows), column], _with_others(each, results), rows, window, looks)
        for axes, dof in zip(panels[:, 3], rows, strict=False):
            if record.unforced[dof]:
                _write_rms(axes, results.estimate.response.force[window, dof])
        if shaken and ground is not None:
            _draw_ground(panels[-2:], _with_others(ground, results), window, looks)
        for axes, dof in zip(panels[:, 0], rows, strict=False):
            name = record.dof_name(dof) if record.dofs else f"DOF {dof + 1}"
            axes.set_ylabel(name + ("" if record.observed[dof] else "*"))
        for axes in panels.flat:
            axes.xaxis.set_major_locator(MaxNLocator(4))  # panels are narrow
        figure.align_ylabels(list(panels[: len(rows), 0]))
        room: style.Look = (
            {"handlelength": 2.2} if results.linear_response is None else {"handlelength": 1.8, "columnspacing": 0.8}
        )
        style.legend(figure, markerscale=1.5, **room)
        notes = [] if record.observed[rows].all() else ["* no response sensor"]
        if len(record.time[window]) < len(record.time):
            notes.append(f"middle of the record from {record.time[0]:g} s to {record.time[-1]:g} s")
        style.note(figure, "; ".join(notes))
    return figure


def shown_dofs(ndof: int) -> list[int]:
    """The DOFs with a row, as indices from 0."""
    return list(range(ndof)) if ndof <= ROWS_IN_FULL else [0, 1, ndof - 2, ndof - 1]


def shown_window(time: np.ndarray, response: Response) -> slice:
    """The stretch of the record that is drawn: all of it, or a few periods of its middle if there are too many.

    A period is twice the mean distance of the velocity's changes of sign (the displacement's may ride on a drift).
    """
    return histories.window_about(len(time) // 2, len(time), histories.periods_of(response.velocity))


def _with_others(each: Histories, results: Results) -> Histories:
    """Beside the baseline's, and those of the equivalent linear system."""
    baseline = None if results.baseline is None else results.baseline.response
    found = {
        name: getattr(response, each.name)
        for name, response in (("linear", results.linear_response), ("baseline", baseline))
        if response is not None
    }
    return each.beside(**{name: x if x is None or x.ndim > 1 else x[:, None] for name, x in found.items()})


def _draw_ground(rows: np.ndarray, ground: Histories, window: slice, looks: histories.Looks) -> None:
    """The ground's acceleration in the last row, below those of the DOFs; its other panels stay empty."""
    column = QUANTITIES.index("acceleration")
    above, axes = rows[:, column]
    for empty in rows[-1, np.arange(len(QUANTITIES)) != column]:
        empty.set_axis_off()
    histories.draw_column(rows[-1:, column], ground, [0], window, looks)
    # There is no room between panels for a title and the times, which stand below.
    axes.text(0.03, 0.93, axes.get_title(), transform=axes.transAxes, va="top", fontsize=7)
    axes.set_title("")
    above.tick_params(labelbottom=False)
    above.set_xlabel("")


def _write_rms(axes: Axes, estimate: np.ndarray) -> None:
    """The size of an estimated force where there is none, which the common scale hides."""
    if np.isfinite(estimate).all():
        rms = float(np.sqrt(np.mean(estimate**2)))
        factor, prefix = style.unit_prefix(rms, kilo=True)
        text = f"rms {factor * rms:.{0 if factor * rms >= 10.0 else 1}f} {style.unit('force', prefix)}"
        axes.text(0.97, 0.93, text, transform=axes.transAxes, ha="right", va="top", fontsize=7)


def error_map_figure(estimate: Estimate, record: Record, truth: Response | None) -> Figure:
    """One panel per quantity: |estimate - truth| with time to the right and DOFs downwards.

    Where the truth of a quantity is known at no DOF, its panel shows the estimate's standard deviation and says so; a
    DOF with neither is hatched. A column of pixels shows the largest value of its stretch of time. The dashed red lines
    frame the DOFs with a response sensor (paper, figure of the 20-DOF case).
    """
    with style.look():
        height = min(max(0.16 * record.ndof, 1.2), 2.4)
        figure, panels = style.panels(2, 2, height, margins=(0.45, 0.5, 0.3, 0.5), gaps=(0.95, 0.5))
        for axes, quantity in zip(panels.flat, QUANTITIES, strict=True):
            values, meaning = getattr(estimate.std, quantity), "standard deviation, no truth"
            error = np.abs(getattr(estimate.response, quantity) - getattr(truth, quantity, np.nan))
            if np.isfinite(error).any():
                values, meaning = error, "absolute error"
            prefix = _draw_map(figure, axes, record, values, quantity)
            axes.set_title(f"{quantity.capitalize()}: {meaning} ({style.unit(quantity, prefix)})", pad=4)
            _frame_observed(axes, record)
        for axes in panels[1]:
            axes.set_xlabel(r"Time $t$ (s)")
        for axes in panels[:, 0]:
            axes.set_ylabel("DOF")
        if any(axes.patch.get_hatch() for axes in panels.flat):
            style.note(figure, "hatched: no truth")
    return figure


def _draw_map(figure: Figure, axes: Axes, record: Record, values: np.ndarray, quantity: str) -> str:
    """Draw values (time, dof) with their scale; the prefix of its unit."""
    peak = float(np.nanmax(values, initial=0.0))
    factor, prefix = style.unit_prefix(peak, kilo=quantity == "force")
    if not np.isfinite(values).all():
        axes.patch.set(hatch="////", facecolor="#F2F2F2", edgecolor="#BFBFBF", linewidth=0)
    extent = (record.time[0], record.time[-1], record.ndof + 0.5, 0.5)
    shown = np.ma.masked_invalid(factor * block_maximum(values).T)
    colours: style.Look = {"cmap": colormaps["viridis"], "vmin": 0.0, "vmax": factor * peak or 1.0}
    image = axes.imshow(shown, extent=extent, aspect="auto", interpolation="nearest", **colours)
    bar = figure.colorbar(image, cax=axes.inset_axes((1.025, 0.0, 0.035, 1.0)))
    bar.outline.set_linewidth(0.4)
    bar.locator = MaxNLocator(5)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    # The first DOF and round numbers, ten labels at most.
    step = next(step for step in (1, 2, 5, 10, 20, 50, 100, record.ndof) if record.ndof / step <= 9)
    ticks = [1, *range(max(step, 2), record.ndof + 1, step)]
    axes.set_yticks(ticks, [record.dof_name(dof - 1) for dof in ticks])
    axes.tick_params(direction="out")
    return prefix


def block_maximum(values: np.ndarray, columns: int = 400) -> np.ndarray:
    """(columns, dof): the largest of values (time, dof) in each stretch of time, so that no peak of an error is lost.

    Fewer values than that stay as they are. NaN is unknown.
    """
    if len(values) <= columns:
        return values
    edges = np.linspace(0, len(values), columns + 1).astype(int)[:-1]
    return np.fmax.reduceat(values, edges, axis=0)


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
