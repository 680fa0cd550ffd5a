"""Parameters: with their intervals, as they moved; their correlation; and what each record made of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.report.parameters import true_value
from pinn_cli.system.parameters import Parameter, letter
from pinn_cli.training.central_interval import HALF_WIDTH_90
from pinn_cli.training.estimate import ParameterEstimate

_ROW, _TOP, _BOTTOM = 2.3, 0.5, 0.39  # inch: of a row of panels, and of its legend and titles, its ticks and labels
_LEFT, _RIGHT = 0.55, 0.08
_NAMES, _LETTER = 0.12, 0.056  # inch: below the axis, and of each letter of the longest name that stands there
# A start that lies further from all else in a panel than this many times its height would squash it: an arrow at the
# edge points there instead.
REACH = 1.0
NAMED = 20  # names below a panel, at most
TICKS_IN_FULL = 8  # of values in a panel: up to these, exactly their connections are marked

ANNOTATED = 16  # parameters up to which every cell of a matrix has its number: as many as fit across a page
LABELLED = 60  # parameters up to which every row has its name
_CELL, _LEAST = 0.34, 1.2  # inch, of a cell and of the matrix
_AROUND = 0.5, 0.75, 0.3, 0.4  # inch, left, right, above, below

COLUMNS, MOST = 3, 24  # of panels over records

_START: style.Look = {"linestyle": "none", "color": style.GREY, "zorder": 1}
_ESTIMATE: style.Look = {"color": style.VERMILLION, "markersize": 3, "zorder": 3}
_BARS: style.Look = {"elinewidth": 0.9, "capsize": 2, "capthick": 0.9}


def parameters_figure(estimates: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> Figure:
    """One panel per kind, over the connections, with 90 % intervals; unknown parameters above prescribed ones.

    Unknown parameters are drawn as they are, in their unit, with the values from which the search for them started.
    Prescribed ones are drawn as relative changes from what was prescribed; where that is zero they are left out. True
    values (members,) by kind are marked where known.

    Raises:
        ValueError: If there is nothing to draw.
    """
    unknown = _by_kind(given for given in estimates if given.unknown)
    prescribed = _by_kind(given for given in estimates if given.prescribed and not given.unknown)
    rows = [row for row in (unknown, prescribed) if row]
    if not rows:
        raise ValueError("there is no estimated parameter that is unknown or has a prescribed value other than zero")
    longest = max(len(given.parameter.label) for row in rows for group in row.values() for given in group)
    with style.look():
        width = min(1.2 + 2.0 * max(map(len, rows)), style.PAGE_WIDTH)
        bottom = _BOTTOM if not longest else _NAMES + _LETTER * longest
        height = _ROW + bottom - _BOTTOM
        figure = Figure(figsize=(width, height * len(rows)))
        grid = {"left": _LEFT / width, "right": 1.0 - _RIGHT / width, "wspace": 0.28}
        grid |= {"bottom": bottom / height, "top": 1.0 - _TOP / height}
        places = [figure] if len(rows) == 1 else np.asarray(figure.subfigures(len(rows), 1)).tolist()
        for place, row in zip(places, rows, strict=True):
            panels = place.subplots(1, len(row), squeeze=False, gridspec_kw=grid)[0]
            for axes, (kind, group) in zip(panels, row.items(), strict=True):
                unit = _draw_values(axes, group, true) if row is unknown else _draw_changes(axes, group, true)
                title = f"{group[0].parameter.title} ${letter(kind)}$".strip()
                axes.set_title(title + (f" ({style.raised(unit)})" if unit else ""), pad=4)
            panels[0].set_ylabel("Identified value" if row is unknown else "Change from prescribed (%)")
            style.legend(place, panels)
    return figure


def _by_kind(estimates: Iterable[ParameterEstimate]) -> dict[str, list[ParameterEstimate]]:
    groups: dict[str, list[ParameterEstimate]] = {}
    for given in estimates:
        groups.setdefault(given.kind, []).append(given)
    return groups


def _draw_values(axes: Axes, group: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> str:
    """Unknown parameters of one kind, with where they started; the unit with the prefix in which they are drawn."""
    values, unit = _values(group, true), group[0].parameter.unit
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(values))), kilo=True) if unit else (1.0, "")
    start = factor * np.array([given.start for given in group])
    place = _draw_group(axes, group, factor * values)
    bottom, top = float(np.nanmin(factor * values)), float(np.nanmax(factor * values))
    least = 1e-6 * max(abs(bottom), abs(top)) or 1.0
    if top - bottom <= least:
        bottom, top = bottom - least, top + least
    height = top - bottom
    near = (start >= bottom - REACH * height) & (start <= top + REACH * height)
    if near.any():
        axes.plot(place[near], start[near], marker="x", markersize=4.5, markeredgewidth=0.9, label="start", **_START)
        bottom, top = min(bottom, start[near].min()), max(top, start[near].max())
    below, above = start < bottom, start > top
    _point_to_start(axes, place[below], start[below], "v", 0.05)
    _point_to_start(axes, place[above], start[above], "^", 0.95)
    height = top - bottom
    # An arrow and its number take the room that no value may be in.
    axes.set_ylim(bottom - (0.25 if below.any() else 0.1) * height, top + (0.25 if above.any() else 0.1) * height)
    if len(place) <= TICKS_IN_FULL and not group[0].parameter.label:
        axes.set_xticks(place)
    return prefix + unit


def _draw_changes(axes: Axes, group: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> str:
    """How far parameters of one kind, none prescribed as zero, moved from their prescribed values, in percent."""
    prescribed = np.array([given.believed for given in group])
    axes.axhline(0.0, color=style.GREY, linewidth=0.7, linestyle="--", zorder=1, label="prescribed")
    _draw_group(axes, group, 100.0 * (_values(group, true) / prescribed - 1.0))
    return ""


def _values(group: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> np.ndarray:
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
        axes.errorbar(place, middle, yerr=reach, fmt="none", ecolor=style.VERMILLION, zorder=3, **_BARS)
        axes.errorbar([], [], yerr=[], fmt="o", **_ESTIMATE, **_BARS, label="estimate, 90 % interval")
    if np.isfinite(truth).any():
        diamond: style.Look = {
            "markersize": 4.5,
            "markerfacecolor": "none",
            "markeredgecolor": style.BLACK,
            "markeredgewidth": 0.8,
        }
        axes.plot(place, truth, linestyle="none", marker="D", zorder=2, label="truth", **diamond)
    axes.set_xlim(place.min() - 0.6, place.max() + 0.6)
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True, min_n_ticks=1))
    axes.yaxis.set_major_locator(MaxNLocator(6))
    if names[0]:
        # Upright, so that long ones do not meet.
        every = -(-len(names) // NAMED)
        axes.set_xticks(place[::every], names[::every], rotation=90)
    else:
        axes.set_xlabel("Connection $i$", labelpad=2)
    return place


def _point_to_start(axes: Axes, place: np.ndarray, start: np.ndarray, arrow: str, height: float) -> None:
    """Arrows at an edge of the panel, with the value that they point to; equal ones in a row say it once."""
    if not start.size:
        return
    across, label = axes.get_xaxis_transform(), "start, off the scale"
    axes.plot(place, np.full(start.size, height), transform=across, marker=arrow, markersize=3.5, label=label, **_START)
    look: style.Look = {"textcoords": "offset points", "va": "center", "fontsize": 6.5, "color": style.GREY}
    for i, (x, value) in enumerate(zip(place, start, strict=True)):
        if i == 0 or value != start[i - 1]:
            axes.annotate(f"{value:.4g}", (x, height), xycoords=across, xytext=(4, 0), **look)


def correlation_figure(estimates: Sequence[ParameterEstimate], correlation: np.ndarray) -> Figure:
    """The posterior correlation (p, p) of p parameters, unknown ones first; a line parts them from the prescribed ones.

    Raises:
        ValueError: If there are fewer than two parameters.
    """
    count = len(estimates)
    if count < 2:
        raise ValueError("a correlation takes two parameters")
    order = sorted(range(count), key=lambda i: not estimates[i].unknown)
    unknown = sum(p.unknown for p in estimates)
    matrix = np.asarray(correlation)[np.ix_(order, order)]
    left, right, top, bottom = _AROUND
    side = max(min(_CELL * count, style.PAGE_WIDTH - left - right), _LEAST)
    width, height = left + side + right, bottom + side + top
    with style.look():
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((left / width, bottom / height, side / width, side / height))
        # A parameter's correlation with itself says nothing and would be the darkest of all cells.
        shown = np.ma.masked_where(np.eye(count, dtype=bool) | ~np.isfinite(matrix), matrix)
        axes.patch.set_facecolor("#E6E6E6")
        image = axes.imshow(shown, cmap=colormaps["RdBu_r"], vmin=-1.0, vmax=1.0, interpolation="nearest")
        bar = figure.colorbar(image, cax=axes.inset_axes((1.0 + 0.1 / side, 0.0, 0.12 / side, 1.0)))
        bar.outline.set_linewidth(0.4)
        bar.set_label("Posterior correlation")
        _name_rows(axes, [estimates[i].parameter for i in order])
        for line in (axes.axhline, axes.axvline) if 0 < unknown < count else ():
            line(unknown - 0.5, color=style.BLACK, linewidth=0.9)
        for label, first, end in (("unknown", 0, unknown), ("prescribed", unknown, count)):
            if end > first:
                look: style.Look = {"textcoords": "offset points", "ha": "center", "va": "bottom", "fontsize": 8}
                place, across = ((first + end) / 2 - 0.5, 1.0), axes.get_xaxis_transform()
                axes.annotate(label, place, xycoords=across, xytext=(0, 4), **look)
        for (row, column), value in np.ndenumerate(shown.filled(np.nan) if count <= ANNOTATED else np.zeros((0, 0))):
            if np.isfinite(value):
                write_correlation(axes, (column, row), value, f"{round(value, 2) + 0.0:.2f}", fontsize=6)
    return figure


def write_correlation(axes: Axes, place: tuple[float, float], value: float, text: str, **look: Any) -> None:
    """A correlation on its colour, in white where that is dark."""
    colour = "white" if abs(value) > 0.65 else style.BLACK
    axes.text(*place, text.replace("-", "\N{MINUS SIGN}"), ha="center", va="center", color=colour, **look)


def _name_rows(axes: Axes, parameters: Sequence[Parameter]) -> None:
    symbols, named = [p.symbol for p in parameters], any(p.label for p in parameters)
    kept = range(0, len(symbols), math.ceil(len(symbols) / LABELLED))
    labels = [symbols[i] for i in kept]
    size = 8.0 if len(symbols) <= ANNOTATED else 6.0
    axes.set_xticks(kept, labels, fontsize=size, rotation=0 if len(symbols) <= ANNOTATED and not named else 90)
    axes.set_yticks(kept, labels, fontsize=size)
    axes.tick_params(length=0)


def over_time_figure(table: pd.DataFrame) -> Figure:
    """A panel for every parameter: its estimate after each record with its 90 % band, and what the record says alone.

    Of more than `MOST` parameters those that changed are shown, and those that are known best. The table is that of
    `pinn_cli.report.over_time.parameters_over_time`.
    """
    names = _shown(table)
    with style.look():
        rows = -(-len(names) // COLUMNS)
        figure, panels = style.panels(rows, COLUMNS, 1.05, margins=(0.6, 0.08, 0.45, 0.4), gaps=(0.6, 0.32))
        for axes in panels.flat[len(names) :]:
            axes.remove()
        for axes, name in zip(panels.flat, names, strict=False):
            _draw_over_records(axes, table[table["parameter"] == name], name)
        for axes in panels[-1]:
            axes.set_xlabel("Record", labelpad=2)
        style.legend(figure)
    return figure


def _shown(table: pd.DataFrame) -> list[str]:
    names = list(dict.fromkeys(table["parameter"]))
    last = table[table["record"] == table["record"].max()].set_index("parameter")
    relative = (last["std"] / last["estimate"].abs()).replace(np.nan, np.inf)
    changed = set(table.loc[table["changed"], "parameter"])
    best = sorted(names, key=lambda name: (name not in changed, relative.get(name, np.inf)))[:MOST]
    return [name for name in names if name in best]


def _draw_over_records(axes: Axes, own: pd.DataFrame, name: str) -> None:
    factor, prefix = style.unit_prefix(float(own["estimate"].abs().max()), kilo=True)
    record, unit = own["record"].to_numpy(), str(own["unit"].iloc[-1]) if own["unit"].notna().all() else ""
    estimate, lower, upper, alone = factor * own[["estimate", "lower_90", "upper_90", "alone"]].to_numpy(float).T
    axes.plot(record, estimate, color=style.BLUE, marker="o", markersize=2.5, linewidth=1.0, label="after the record")
    axes.fill_between(record, lower, upper, color=style.BLUE, alpha=0.25, linewidth=0, label="90 % band")
    low, high = axes.get_ylim()
    half = factor * HALF_WIDTH_90 * own["alone_std"].to_numpy()
    dots: style.Look = {"color": style.GREY, "linestyle": "none", "marker": ".", "markersize": 3.0, "elinewidth": 0.6}
    axes.errorbar(record + 0.12, alone, half, label="by the record alone", **dots)
    reach = np.clip(alone, low - 2 * (high - low), high + 2 * (high - low))
    spread, margin = reach[np.isfinite(reach)], 0.1 * (high - low)
    axes.set_ylim(min(low, spread.min(initial=low)) - margin, max(high, spread.max(initial=high)) + margin)
    for at in own.loc[own["changed"].astype(bool), "record"]:
        axes.axvline(at - 0.5, color=style.VERMILLION, linestyle=(0, (3, 2)), linewidth=1.0, label="changed")
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.set_title(f"{name} ({prefix}{style.raised(unit)})" if unit else name, pad=3)
