"""Parameters with their intervals, as they moved; their correlation; what each record made of them; and mode shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.estimates import ModeEstimates
from pinn_cli.report.figures import style
from pinn_cli.report.parameters import true_value
from pinn_cli.system.parameters import letter
from pinn_cli.system.priors import HALF_WIDTH_90
from pinn_cli.training.estimate import ParameterEstimate

Truth = Mapping[str, np.ndarray] | None  # values (members,) by kind, where known
LEGEND = 4.6  # inch, of a legend with all that there is
START_REACH = 1.0  # heights of a panel that a start may be away from all else; further off it would squash the scale
NAMED = 20  # names below a panel, at most
TICKS_IN_FULL = 8  # of values in a panel: up to these, exactly their connections are marked
ANNOTATED, LABELLED = 16, 60  # parameters up to which every cell of a matrix has its number, and every row its name
PANELS_IN_A_ROW, MOST_OVER_TIME = 3, 24  # of panels over records
MODES_DRAWN, IN_A_ROW, MOST_DOF_LABELS = 12, 4, 16  # of more modes, the lowest

_ESTIMATE: style.Look = {"color": style.VERMILLION, "markersize": 3, "zorder": 3}
_ERROR_BARS: style.Look = {"elinewidth": 0.9, "capsize": 2, "capthick": 0.9}
_TRUE: style.Look = {
    "linestyle": "none", "marker": "D", "markersize": 4.5, "markerfacecolor": "none", "markeredgecolor": style.BLACK,
    "markeredgewidth": 0.8, "zorder": 2, "label": "truth",
}  # fmt: skip
_SHAPES: dict[str, style.Look] = {
    "true": {"color": style.BLACK, "linewidth": 1.0},
    "prescribed": {"color": style.BLUE, "linewidth": 0.9, "linestyle": (0, (1, 1.2)), "label": "prescribed"},
    "estimate": {
        "color": style.VERMILLION, "linewidth": 0.9, "linestyle": (0, (2.5, 1.2)), "marker": "o", "markersize": 3.0,
        "label": "estimate (90 % intervals)",
    },
}  # fmt: skip


@style.look()
def parameters_figure(estimates: Sequence[ParameterEstimate], true: Truth) -> Figure:
    """One panel per kind, over the connections, with 90 % intervals; unknown parameters above prescribed ones.

    Unknown parameters are drawn as they are, in their unit, with the values from which the search for them started: a
    triangle at the edge points to one that is far away, and says its value. Prescribed ones are drawn as relative
    changes from what was prescribed; where that is zero they are left out. There is one to draw.
    """
    rows = [[p for p in estimates if p.unknown], [p for p in estimates if p.prescribed and not p.unknown]]
    kinds = [{kind: [p for p in row if p.kind == kind] for kind in dict.fromkeys(p.kind for p in row)} for row in rows]
    kinds = [row for row in kinds if row]
    longest = max(len(p.parameter.label) for row in rows for p in row)
    width = float(np.clip(1.2 + 2.0 * max(map(len, kinds)), LEGEND, style.PAGE_WIDTH))
    bottom = 0.12 + 0.056 * longest if longest else 0.39  # inch, with room for upright names
    height = 1.91 + bottom
    figure = Figure(figsize=(width, height * len(kinds)))
    grid = {"left": 0.55 / width, "right": 1.0 - 0.08 / width, "wspace": 0.28}
    grid |= {"bottom": bottom / height, "top": 1.0 - 0.5 / height}
    places = [figure] if len(kinds) == 1 else np.asarray(figure.subfigures(len(kinds), 1)).tolist()
    for place, row in zip(places, kinds, strict=True):
        panels = place.subplots(1, len(row), squeeze=False, gridspec_kw=grid)[0]
        for axes, (kind, group) in zip(panels, row.items(), strict=True):
            unit = (_draw_values if group[0].unknown else _draw_changes)(axes, group, true)
            title = f"{group[0].parameter.title} ${letter(kind)}$".strip()
            axes.set_title(title + (f" ({style.raised(unit)})" if unit else ""), pad=4)
        panels[0].set_ylabel("Identified value" if group[0].unknown else "Change from prescribed (%)")
        style.legend(place, panels)
    return figure


def _draw_values(axes: Axes, group: Sequence[ParameterEstimate], true: Truth) -> str:
    """Unknown parameters of one kind, with where they started; the unit with the prefix in which they are drawn."""
    values, unit = _values(group, true), group[0].parameter.unit
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(values))), kilo=True) if unit else (1.0, "")
    start, place = factor * np.array([given.start for given in group]), _draw_group(axes, group, factor * values)
    bottom, top = float(np.nanmin(factor * values)), float(np.nanmax(factor * values))
    height = max(top - bottom, 2e-6 * max(abs(bottom), abs(top))) or 2.0
    below, above = start < bottom - START_REACH * height, start > top + START_REACH * height
    near, look = start[~(below | above)], style.Look(linestyle="none", color=style.GREY, zorder=1)
    if near.size:
        axes.plot(place[~(below | above)], near, "x", markersize=4.5, markeredgewidth=0.9, label="start", **look)
        bottom, top = min(bottom, near.min()), max(top, near.max())
    across = axes.get_xaxis_transform()
    for far, arrow, edge in ((below, "v", 0.05), (above, "^", 0.95)):
        if far.any():
            axes.plot(place[far], np.full(far.sum(), edge), arrow, markersize=3.5, transform=across,
                      label="start, off the scale", **look)  # fmt: skip
        for value, x in dict(zip(start[far][::-1], place[far][::-1], strict=True)).items():  # equal ones say it once
            said = style.Look(textcoords="offset points", va="center", fontsize=6.5, color=style.GREY)
            axes.annotate(f"{value:.4g}", (x, edge), xycoords=across, xytext=(4, 0), **said)
    # An arrow takes the room that no value may be in.
    low, high = (0.25 if far.any() else 0.1 for far in (below, above))
    height = max(top - bottom, height)
    axes.set_ylim(bottom - low * height, top + high * height)
    if len(place) <= TICKS_IN_FULL and not group[0].parameter.label:
        axes.set_xticks(place)
    return prefix + unit


def _draw_changes(axes: Axes, group: Sequence[ParameterEstimate], true: Truth) -> str:
    """How far parameters of one kind, none prescribed as zero, moved from their prescribed values, in percent."""
    prescribed = np.array([given.believed for given in group])
    axes.axhline(0.0, color=style.GREY, linewidth=0.7, linestyle="--", zorder=1, label="prescribed")
    _draw_group(axes, group, 100.0 * (_values(group, true) / prescribed - 1.0))
    return ""


def _values(group: Sequence[ParameterEstimate], true: Truth) -> np.ndarray:
    """(4, parameters): estimate, ends of its interval, truth; NaN where unknown."""
    rows = [(given.estimate, given.lower_90, given.upper_90, true_value(given.parameter, true)) for given in group]
    return np.array(rows, dtype=float).T


def _draw_group(axes: Axes, group: Sequence[ParameterEstimate], values: np.ndarray) -> np.ndarray:
    """Values (4, parameters) of one kind at their numbers, those with names side by side; the places (parameters,)."""
    estimate, lower, upper, truth = values
    names = [given.parameter.label for given in group]
    place = np.array([i + 1 if names[0] else given.parameter.index + 1 for i, given in enumerate(group)])
    # The interval stands on its own: a prescribed value below zero turns a relative one round.
    middle, reach = (lower + upper) / 2.0, np.abs(upper - lower) / 2.0
    axes.plot(place, estimate, "o", **_ESTIMATE, label="" if np.isfinite(reach).any() else "estimate")
    if np.isfinite(reach).any():
        axes.errorbar(place, middle, yerr=reach, fmt="none", ecolor=style.VERMILLION, zorder=3, **_ERROR_BARS)
        axes.errorbar([], [], yerr=[], fmt="o", **_ESTIMATE, **_ERROR_BARS, label="estimate, 90 % interval")
    if np.isfinite(truth).any():
        axes.plot(place, truth, **_TRUE)
    axes.set_xlim(place.min() - 0.6, place.max() + 0.6)
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True, min_n_ticks=1))
    axes.yaxis.set_major_locator(MaxNLocator(6))
    if names[0]:
        stride = -(-len(names) // NAMED)
        axes.set_xticks(place[::stride], names[::stride], rotation=90)  # upright: long ones do not meet
    elif not (first := group[0].parameter).alone:
        owner = first.owner.removesuffix(first.whose)
        axes.set_xlabel(f"{owner[0].upper()}{owner[1:]}$i$", labelpad=2)
    return place


@style.look()
def correlation_figure(estimates: Sequence[ParameterEstimate], correlation: np.ndarray) -> Figure:
    """The posterior correlation (p, p) of two parameters or more, unknown ones first; a line parts them from others."""
    count = len(estimates)
    order = sorted(range(count), key=lambda i: not estimates[i].unknown)
    unknown, parameters = sum(p.unknown for p in estimates), [estimates[i].parameter for i in order]
    matrix, few = np.asarray(correlation)[np.ix_(order, order)], count <= ANNOTATED
    side = float(np.clip(0.34 * count, 1.2, style.PAGE_WIDTH - 1.25))  # inch
    figure, ((axes,),) = style.panels(1, 1, side, width=side + 1.25, margins=(0.5, 0.75, 0.3, 0.4), gaps=(0, 0))
    # A parameter's correlation with itself says nothing and would be the darkest of all cells.
    shown = np.ma.masked_where(np.eye(count, dtype=bool) | ~np.isfinite(matrix), matrix)
    axes.patch.set_facecolor("#E6E6E6")
    image = axes.imshow(shown, cmap=colormaps["RdBu_r"], vmin=-1.0, vmax=1.0, interpolation="nearest")
    bar = figure.colorbar(image, cax=axes.inset_axes((1.0 + 0.1 / side, 0.0, 0.12 / side, 1.0)))
    bar.outline.set_linewidth(0.4)
    bar.set_label("Posterior correlation")
    kept = range(0, count, -(-count // LABELLED))
    labels = [parameters[i].symbol for i in kept]
    level = few and not any(p.label for p in parameters)
    axes.set_xticks(kept, labels, fontsize=8.0 if few else 6.0, rotation=0 if level else 90)
    axes.set_yticks(kept, labels, fontsize=8.0 if few else 6.0)
    axes.tick_params(length=0)
    for line in (axes.axhline, axes.axvline) if 0 < unknown < count else ():
        line(unknown - 0.5, color=style.BLACK, linewidth=0.9)
    for label, first, end in (("unknown", 0, unknown), ("prescribed", unknown, count)):
        if end > first:
            place, look = ((first + end) / 2 - 0.5, 1.0), style.Look(textcoords="offset points", ha="center")
            axes.annotate(label, place, xytext=(0, 4), xycoords=axes.get_xaxis_transform(), **look)
    for (row, column), value in np.ndenumerate(shown.filled(np.nan) if few else np.zeros((0, 0))):
        if np.isfinite(value):
            write_correlation(axes, (column, row), value, f"{round(value, 2) + 0.0:.2f}", fontsize=6)
    return figure


def write_correlation(axes: Axes, place: tuple[float, float], value: float, text: str, **look: Any) -> None:
    """A correlation on its colour, in white where that is dark."""
    colour = "white" if abs(value) > 0.65 else style.BLACK
    axes.text(*place, text.replace("-", "\N{MINUS SIGN}"), ha="center", va="center", color=colour, **look)


@style.look()
def over_time_figure(table: pd.DataFrame, of: str = "Record") -> Figure:
    """A panel for every parameter: its estimate after each record with its 90 % band, and what the record says alone.

    Of more than `MOST_OVER_TIME` parameters those that changed are shown, and those that are known best. The table is
    that of `pinn_cli.report.parameters.parameters_over_time`; ``of`` is what its ``record`` counts.
    """
    last = table[table["record"] == table["record"].max()].set_index("parameter")
    relative = (last["std"] / last["estimate"].abs()).replace(np.nan, np.inf)
    changed = set(table.loc[table["changed"], "parameter"])
    names = list(dict.fromkeys(table["parameter"]))
    best = sorted(names, key=lambda name: (name not in changed, relative.get(name, np.inf)))[:MOST_OVER_TIME]
    shown = [name for name in names if name in best]
    rows = -(-len(shown) // PANELS_IN_A_ROW)
    figure, panels = style.panels(rows, PANELS_IN_A_ROW, 1.05, margins=(0.6, 0.08, 0.45, 0.4), gaps=(0.6, 0.32))
    for axes in panels.flat[len(shown) :]:
        axes.remove()
    for axes, name in zip(panels.flat, shown, strict=False):
        _draw_over_records(axes, table[table["parameter"] == name], name)
    for axes in panels[-1]:
        axes.set_xlabel(of, labelpad=2)
    style.legend(figure)
    return figure


def _draw_over_records(axes: Axes, rows: pd.DataFrame, name: str) -> None:
    factor, prefix = style.unit_prefix(float(rows["estimate"].abs().max()), kilo=True)
    record, unit = rows["record"].to_numpy(), str(rows["unit"].iloc[-1]) if rows["unit"].notna().all() else ""
    estimate, lower, upper, alone = factor * rows[["estimate", "lower_90", "upper_90", "alone"]].to_numpy(float).T
    axes.plot(record, estimate, color=style.BLUE, marker="o", markersize=2.5, linewidth=1.0, label="with all so far")
    axes.fill_between(record, lower, upper, color=style.BLUE, alpha=0.25, linewidth=0, label="90 % band")
    low, high = axes.get_ylim()
    half = factor * HALF_WIDTH_90 * rows["alone_std"].to_numpy()
    dots: style.Look = {"color": style.GREY, "linestyle": "none", "marker": ".", "markersize": 3.0, "elinewidth": 0.6}
    axes.errorbar(record + 0.12, alone, half, label="by itself", **dots)
    reach = np.clip(alone, low - 2 * (high - low), high + 2 * (high - low))
    spread, margin = reach[np.isfinite(reach)], 0.1 * (high - low)
    axes.set_ylim(min(low, spread.min(initial=low)) - margin, max(high, spread.max(initial=high)) + margin)
    for at in rows.loc[rows["changed"].astype(bool), "record"]:
        axes.axvline(at - 0.5, color=style.VERMILLION, linestyle=(0, (3, 2)), linewidth=1.0, label="changed")
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.set_title(f"{name} ({prefix}{style.raised(unit)})" if unit else name, pad=3)


@style.look()
def modes_figure(modes: ModeEstimates, truth_label: str = "truth") -> Figure:
    """A panel per mode: its shape over the DOFs; above it frequency and damping ratio with their 90 % intervals.

    Of a chain the shape begins at the fixed end, and DOF 1 is the lowest. The DOFs of another structure stand in their
    own order, as points. Of more than `MODES_DRAWN` modes the lowest are drawn.
    """
    dofs, count = modes.dofs, len(modes.table)
    shown = min(count, MODES_DRAWN)
    columns = min(shown, IN_A_ROW)
    width = style.PAGE_WIDTH if columns > 2 else 2.6 + 1.3 * columns
    left = 0.42 + 0.055 * min(max(map(len, dofs)), 16)  # inch, with room for the names of the DOFs
    figure, panels = style.panels(
        -(-shown // columns), columns, float(np.clip(0.16 * len(dofs), 1.3, 2.6)), width=width,
        margins=(left, 0.1, 0.72, 0.32), gaps=(0.16, 0.74), sharey=True,
    )  # fmt: skip
    for axes in panels.flat[shown:]:
        axes.set_axis_off()
    for mode, axes in enumerate(panels.flat[:shown]):
        _draw_shape(axes, modes, mode, truth_label)
    places = range(1, len(dofs) + 1, -(-len(dofs) // MOST_DOF_LABELS))
    for axes in panels[:, 0]:
        axes.set_yticks(list(places), [dofs[i - 1] for i in places])
        axes.set_ylabel("DOF", labelpad=2)
    style.legend(figure)
    if shown < count:
        style.note(figure, f"the {shown} lowest of {count} modes")
    return figure


def _draw_shape(axes: Axes, modes: ModeEstimates, mode: int, truth_label: str) -> None:
    place, row = np.arange(1, len(modes.dofs) + 1), modes.table.iloc[mode]
    axes.axvline(0.0, color="#BFBFBF", linewidth=0.5, zorder=1.0)
    for order, (source, shapes) in enumerate(modes.shapes.items()):
        shape, look = shapes[:, mode], {"label": truth_label, "zorder": 2.0 + 0.1 * order, **_SHAPES[source]}
        if np.isfinite(shape).all() and modes.is_chain:
            axes.plot([0.0, *shape], [0, *place], **look, markevery=slice(1, None))
        elif np.isfinite(shape).all():
            axes.plot(shape, place, **{"marker": "|", "markersize": 9.0, **look, "linestyle": "none"})
            if source == "estimate":
                axes.hlines(place, 0.0, shape, color=style.VERMILLION, linewidth=0.6)
    axes.set_xlim(-1.15, 1.15)
    axes.set_ylim((0.0 if modes.is_chain else 0.4), len(modes.dofs) + 0.4)
    axes.set_xticks([-1, 0, 1])
    frequency = interval_text(row["frequency"], row[["lower_90", "upper_90"]].to_numpy(), "Hz")
    ends = row[["damping_ratio_lower_90", "damping_ratio_upper_90"]].to_numpy()
    damping = interval_text(100.0 * row["damping_ratio"], 100.0 * ends, "%")
    mac_text = f"\nMAC {row['mac']:.4f}" if np.isfinite(row["mac"]) else ""
    axes.set_title(
        f"mode {mode + 1}: {frequency}\n" + rf"$\zeta$ = {damping}" + mac_text, pad=3, fontsize=7, linespacing=1.15
    )


def interval_text(value: float, interval: np.ndarray, unit: str) -> str:
    """``2.598 Hz (2.597-2.599)``, with the digits that the interval leaves; without one, four."""
    if not np.isfinite(value):
        return "unknown"
    width = float(np.ptp(interval))
    if not np.isfinite(width) or width <= 0.0:
        return f"{value:.4g} {unit}"
    digits = int(np.clip(1 - np.floor(np.log10(width)), 0, 6))
    lower, upper = interval
    return f"{value:.{digits}f} {unit} ({lower:.{digits}f}\N{EN DASH}{upper:.{digits}f})"
