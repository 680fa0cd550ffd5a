"""Histories in panels: the estimate, its band, and what there is to compare it with, drawn alike everywhere.

On top of that motion and force of the DOFs, in the layout of the paper's Figures 4 to 8, and the map of their errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.report.estimates import Histories, dof_histories, history_of, values_of
from pinn_cli.report.figures import style
from pinn_cli.report.results import Results
from pinn_cli.system.priors import HALF_WIDTH_95
from pinn_cli.system.quantities import GROUND
from pinn_cli.training.estimate import Estimate

POINTS_DRAWN = 400  # observations drawn in a panel at most
PERIODS_IN_FULL, PERIODS_SHOWN = 100, 20  # a longer record shows a stretch, else it is a block of ink
DOFS_IN_FULL = 6  # more DOFs than these: the first two and the last two, as in the paper
PIXELS = 400  # columns of a map

Looks = Mapping[str, style.Look]
# How each source of a history is drawn, in the order of the legend.
LOOKS: Looks = {
    "true": {"label": "truth", "linestyle": "-", "linewidth": 1.0, "color": style.BLACK, "zorder": 2.0},
    "estimate": {
        "label": "estimate", "linestyle": (0, (2.5, 1.2)), "linewidth": 0.8, "color": style.VERMILLION, "zorder": 2.2,
    },
    "band": {"label": "95 % band", "color": style.VERMILLION, "alpha": 0.3, "linewidth": 0, "zorder": 1.9},
    "linear": {
        "label": "equivalent linear system", "linestyle": "-.", "linewidth": 0.6, "color": style.BLUE, "zorder": 1.8,
    },
    "baseline": {"linestyle": (0, (1, 1)), "linewidth": 0.8, "color": style.GREEN, "zorder": 2.3},
    "observed": {"label": "observations", **style.DOTS, "color": style.SKY, "zorder": 1.5},
}  # fmt: skip


def looks(**labels: str) -> Looks:
    """`LOOKS` with other labels for some sources."""
    return {name: {**look, "label": labels.get(name, look.get("label", name))} for name, look in LOOKS.items()}


def draw(
    axes: Axes, histories: Histories, place: int, window: slice, factor: float = 1.0, looks: Looks = LOOKS
) -> None:
    """What there is of one place: lines, with gaps where they are not known, a band, and dots of what was observed.

    ``place`` is a column of the histories, ``window`` has the samples that are shown, ``factor`` leads to the unit of
    the panel.
    """
    time = histories.time[window]
    for source, look in looks.items():
        if source == "band":
            low, high = (factor * x for x in band(histories, place, window))
            if np.isfinite(low).all() and (low < high).any():
                kept = style.line_indices(factor * histories.of("estimate")[window, place])
                axes.fill_between(time[kept], low[kept], high[kept], **look)
            continue
        values = factor * histories.of(source)[window, place]
        if np.isfinite(values).any():
            samples = np.arange(0, len(time), thinned(len(time)))
            kept = samples if source == "observed" else style.line_indices(np.nan_to_num(values))
            axes.plot(time[kept], values[kept], **look)
    axes.set_xlim(time[0], time[-1])
    style.ticks(axes)


def with_truth(looks: Looks, has_truth: bool) -> Looks:
    """Dashes let the truth show through; where it is not known, the estimate has nothing to let through."""
    return looks if has_truth else {**looks, "estimate": {**looks["estimate"], "linestyle": "-"}}


def draw_column(panels: np.ndarray, histories: Histories, places: Sequence[int], window: slice, looks: Looks) -> float:
    """A panel for each place, with the time below and the quantity above; the factor to the unit that is shown.

    Forces have one scale, so that one that should not be there is seen in proportion.
    """
    ends = np.array([_limits(histories, place, window) for place in places])
    if histories.name == "force":
        ends[:] = [np.nanmin(ends[:, 0]), np.nanmax(ends[:, 1])] if np.isfinite(ends).any() else [-1.0, 1.0]
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(ends), initial=0.0)), kilo=histories.name == "force")
    for axes, place, (low, high) in zip(panels, places, ends, strict=True):
        has_truth = bool(np.isfinite(histories.of("true")[window, place]).all())
        draw(axes, histories, place, window, factor, with_truth(looks, has_truth))
        if np.isfinite(low):
            axes.set_ylim(factor * low, factor * high)
        axes.tick_params(labelbottom=axes is panels[-1])
    title = f"{histories.words.capitalize()} {style.SYMBOLS.get(histories.name, '')}".strip()
    panels[0].set_title(f"{title} ({prefix}{histories.unit.replace('^2', style.SQUARED)})", pad=4)
    panels[-1].set_xlabel(r"Time $t$ (s)", labelpad=2)
    return factor


def band(histories: Histories, place: int, window: slice) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge: those that were found, or 1.96 standard deviations about the estimate; NaN of neither."""
    if "lower" in histories.sources:
        return histories.sources["lower"][window, place], histories.sources["upper"][window, place]
    estimate, spread = histories.of("estimate")[window, place], HALF_WIDTH_95 * histories.of("std")[window, place]
    return estimate - spread, estimate + spread


def _limits(histories: Histories, place: int, window: slice) -> tuple[float, float]:
    """Lowest and highest value with a margin; NaN if there is nothing to draw.

    A wide band may triple the range, not more.
    """
    lines = [histories.of(name)[window, place] for name in ("estimate", "true", "linear", "observed")]
    stacked = np.concatenate([line[np.isfinite(line)] for line in lines])
    if not stacked.size:
        return np.nan, np.nan
    low, high = float(stacked.min()), float(stacked.max())
    span = (high - low) or abs(high) or 1.0
    lower, upper = band(histories, place, window)
    if np.isfinite(upper).all():
        low, high = max(min(low, float(lower.min())), low - span), min(max(high, float(upper.max())), high + span)
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def thinned(samples: int) -> int:
    """Every how many samples an observation is drawn."""
    return -(-samples // POINTS_DRAWN)


def window_between(time: np.ndarray, shown: tuple[float, float]) -> slice:
    """The samples from one time to another, two at least."""
    first, stop = (int(i) for i in np.searchsorted(time, shown))
    first = min(first, len(time) - 2)
    return slice(first, max(stop + 1, first + 2))


def window_about(
    middle: int, histories: np.ndarray, shown: int = PERIODS_SHOWN, in_full: int = PERIODS_IN_FULL
) -> slice:
    """The samples of a few periods about one of them, or all of histories (N, n) that have no more than ``in_full``.

    Periods are half the changes of sign, the median of all histories.
    """
    samples, signs = len(histories), np.signbit(histories)
    periods = float(np.median((signs[1:] != signs[:-1]).sum(axis=0))) / 2.0
    if periods <= in_full:
        return slice(0, samples)
    half = max(int(samples * shown / periods / 2.0), 1)
    middle = min(max(middle, half), max(samples - 1 - half, half))
    return slice(middle - half, middle + half + 1)


def shown_dofs(ndof: int) -> list[int]:
    """The DOFs with a row, as indices from 0."""
    return list(range(ndof)) if ndof <= DOFS_IN_FULL else [0, 1, ndof - 2, ndof - 1]


@style.look()
def response_figure(results: Results) -> Figure:
    """Rows are DOFs, an asterisk marks those without a response sensor; columns are u, its two time derivatives, and f.

    Drawn are the estimate with its band of 95 %, the truth where it is known, observations as points (at most
    `POINTS_DRAWN` of a channel), the true response of the equivalent linear system, and that of the baseline. Where the
    ground moves, its acceleration stands in a last row. The force has one scale for all DOFs, so that an estimated
    force where there is none is seen in proportion; its root mean square is written there. Of a record with too many
    periods, those about the largest measured force or motion of the ground: a hammer's blow is among them.
    """
    record, run, estimate = results.record, results.run, results.estimate.response
    rows = shown_dofs(record.ndof)
    # The velocity's periods: the displacement may ride on a drift.
    window = window_about(_largest_input(record), estimate.velocity)
    if results.shown is not None:
        window = window_between(record.time, results.shown)
    ground = None if record.ground_acceleration is None else history_of(results, GROUND)
    stride = thinned(len(record.time[window]))
    seen = "observations" + (f" (one in {stride} shown)" if stride > 1 else "")
    labelled = looks(true=run.truth_label, baseline=run.baseline.replace("_", " "), observed=seen)
    count, margins = len(rows) + (ground is not None), (0.62, 0.08, 0.48, 0.46)
    figure, panels = style.panels(count, len(QUANTITIES), 0.645, margins=margins, gaps=(0.36, 0.077))
    of_dofs = panels[: len(rows)]
    for column, histories in zip(of_dofs.T, dof_histories(results), strict=True):
        draw_column(column, _with_others(histories, results), rows, window, labelled)
    for (first, *_, last), dof in zip(of_dofs, rows, strict=True):
        name = record.dof_name(dof) if record.dofs else f"DOF {dof + 1}"
        first.set_ylabel(name + ("" if record.observed[dof] else "*"))
        if record.unforced[dof]:
            _write_rms(last, estimate.force[window, dof])
    if ground is not None:
        _draw_ground(panels[-2:], _with_others(ground, results), window, labelled)
    for axes in panels.flat:
        axes.xaxis.set_major_locator(MaxNLocator(4))  # panels are narrow
    figure.align_ylabels(list(of_dofs[:, 0]))
    crowded = results.linear_response is not None
    room: style.Look = {"handlelength": 1.8, "columnspacing": 0.8} if crowded else {"handlelength": 2.2}
    style.legend(figure, markerscale=1.5, **room)
    notes = [] if record.observed[rows].all() else ["* no response sensor"]
    if len(record.time[window]) < len(record.time):
        notes.append(f"part of the record from {record.time[0]:g} s to {record.time[-1]:g} s")
    style.note(figure, "; ".join(notes))
    return figure


def _largest_input(record: Record) -> int:
    """The sample of the largest measured force; else of the ground's largest acceleration; else the middle one."""
    acting = np.where(record.sensors("force"), record.force, 0.0)
    if not acting.any():
        acting = np.zeros((len(record.time), 1))
        if record.measured_ground is not None:
            acting[:, 0] = record.measured_ground
    size = np.nan_to_num(np.abs(acting - np.nanmean(acting, axis=0)).max(axis=1))
    return int(np.argmax(size)) if size.any() else len(record.time) // 2


def _with_others(histories: Histories, results: Results) -> Histories:
    """Beside the baseline's, and those of the equivalent linear system."""
    baseline = None if results.baseline is None else results.baseline.response
    others = {"linear": results.linear_response, "baseline": baseline}
    values = {name: values_of(response, histories.name) for name, response in others.items() if response is not None}
    return histories.with_sources(**values)


def _draw_ground(rows: np.ndarray, ground: Histories, window: slice, looks: Looks) -> None:
    """The ground's acceleration in the last row, below those of the DOFs; its other panels stay empty."""
    column = QUANTITIES.index("acceleration")
    above, axes = rows[:, column]
    for empty in rows[-1, np.arange(len(QUANTITIES)) != column]:
        empty.set_axis_off()
    draw_column(rows[-1:, column], ground, [0], window, looks)
    # There is no room between panels for a title, but beside them, where none is drawn.
    axes.text(-0.25, 0.5, axes.get_title(), transform=axes.transAxes, ha="right", va="center", fontsize=8.5)
    axes.set_title("")
    above.tick_params(labelbottom=False)
    above.set_xlabel("")


def _write_rms(axes: Axes, estimate: np.ndarray) -> None:
    """The size of an estimated force where there is none, which the common scale hides."""
    if np.isfinite(estimate).all():
        rms = float(np.sqrt(np.mean(estimate**2)))
        factor, prefix = style.unit_prefix(rms, kilo=True)
        text = f"rms {factor * rms:.{0 if factor * rms >= 10.0 else 1}f} {style.unit('force', prefix)}"
        paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}  # the curve may pass there
        axes.text(0.97, 0.93, text, transform=axes.transAxes, ha="right", va="top", fontsize=7, bbox=paper)


@style.look()
def error_map_figure(estimate: Estimate, record: Record, truth: Response | None) -> Figure:
    """One panel per quantity: |estimate - truth| with time to the right and DOFs downwards.

    Where the truth of a quantity is known at no DOF, its panel shows the estimate's standard deviation and says so; a
    DOF with neither is hatched. A column of pixels shows the largest value of its stretch of time. The dashed red lines
    frame the DOFs with a response sensor (paper, figure of the 20-DOF case).
    """
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
    """Draw values (time, dof) with their scale, no peak of them lost; the prefix of its unit."""
    peak = float(np.nanmax(values, initial=0.0))
    factor, prefix = style.unit_prefix(peak, kilo=quantity == "force")
    if not np.isfinite(values).all():
        axes.patch.set(hatch="////", facecolor="#F2F2F2", edgecolor="#BFBFBF", linewidth=0)
    extent = (record.time[0], record.time[-1], record.ndof + 0.5, 0.5)
    starts = np.linspace(0, len(values), min(PIXELS, len(values)), endpoint=False).astype(int)
    shown = np.ma.masked_invalid(factor * np.fmax.reduceat(values, starts, axis=0).T)
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
