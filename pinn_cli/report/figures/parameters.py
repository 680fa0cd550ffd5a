"""Estimated system parameters with their 90 % intervals: unknown ones as they are, prescribed ones as they moved."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.report.parameters import true_value
from pinn_cli.system.parameters import letter

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

    from pinn_cli.training.estimate import ParameterEstimate

_ROW, _TOP, _BOTTOM = 2.3, 0.5, 0.39  # inch: of a row of panels, and of its legend and titles, its ticks and labels
_LEFT, _RIGHT = 0.55, 0.08
_NAMES, _LETTER = 0.12, 0.056  # inch: below the axis, and of each letter of the longest name that stands there
# A start that lies further from all else in a panel than this many times its height would squash it: an arrow at the
# edge points there instead.
REACH = 1.0
NAMED = 20  # names below a panel, at most
TICKS_IN_FULL = 8  # of values in a panel: up to these, exactly their connections are marked


def parameters_figure(estimates: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> Figure:
    """One panel per kind, over the connections, with 90 % intervals; unknown parameters above prescribed ones.

    Unknown parameters are drawn as they are, in their unit, with the values from which the search for them started.
    Prescribed ones are drawn as relative changes from what was prescribed; where that is zero they are left out.

    Args:
        estimates: At least one that can be drawn.
        true: Kind to values (members,), marked where known; or None.

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
        places = [figure] if len(rows) == 1 else np.asarray(figure.subfigures(len(rows), 1)).tolist()
        for place, row in zip(places, rows, strict=True):
            margins = {"left": _LEFT / width, "right": 1.0 - _RIGHT / width, "bottom": bottom / height, "wspace": 0.28}
            grid = margins | {"top": 1.0 - _TOP / height}
            panels = place.subplots(1, len(row), squeeze=False, gridspec_kw=grid)[0]
            for axes, (kind, group) in zip(panels, row.items(), strict=True):
                title = f"{group[0].parameter.title} ${letter(kind)}$".strip()
                if row is unknown:
                    unit = _draw_values(axes, group, true)
                    title += f" ({style.raised(unit)})" if unit else ""
                else:
                    _draw_changes(axes, group, true)
                axes.set_title(title, pad=4)
            panels[0].set_ylabel("Identified value" if row is unknown else "Change from prescribed (%)")
            _legend(place, panels)
    return figure


def _by_kind(estimates: Iterable[ParameterEstimate]) -> dict[str, list[ParameterEstimate]]:
    groups: dict[str, list[ParameterEstimate]] = {}
    for given in estimates:
        groups.setdefault(given.kind, []).append(given)
    return groups


def _legend(place: Figure | SubFigure, panels: Sequence[Axes]) -> None:
    """One legend above the row, of all that occurs in any of its panels."""
    handles = {
        label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    # Matplotlib lists what has error bars last; what only a later panel has must not come after it.
    labels = sorted(handles, key=lambda label: label.startswith("estimate"))
    place.legend(
        [handles[label] for label in labels], labels, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(labels)
    )


def _draw_values(axes: Axes, group: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> str:
    """Unknown parameters of one kind, with where they started; the unit with the prefix in which they are drawn."""
    unit = group[0].parameter.unit
    values = _values(group, true)
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(values))), kilo=True) if unit else (1.0, "")
    estimate, lower, upper, truth = factor * values
    start = factor * np.array([given.start for given in group])
    connection = _connections(group)
    _draw_estimates(axes, connection, estimate, lower, upper)
    _draw_truth(axes, connection, truth)
    bottom, top = _extent(factor * values)
    height = top - bottom
    near = (start >= bottom - REACH * height) & (start <= top + REACH * height)
    if near.any():
        axes.plot(
            connection[near], start[near], linestyle="none", marker="x", markersize=4.5, markeredgewidth=0.9,
            color=style.GREY, zorder=1, label="start",
        )  # fmt: skip
        bottom, top = min(bottom, start[near].min()), max(top, start[near].max())
    below, above = start < bottom, start > top
    _point_to_start(axes, connection[below], start[below], "v", 0.05)
    _point_to_start(axes, connection[above], start[above], "^", 0.95)
    height = top - bottom
    # An arrow and its number take the room that no value may be in.
    axes.set_ylim(bottom - (0.25 if below.any() else 0.1) * height, top + (0.25 if above.any() else 0.1) * height)
    _dress(axes, connection)
    if len(connection) <= TICKS_IN_FULL:
        axes.set_xticks(connection)
    _name_connections(axes, group)
    return prefix + unit


def _draw_changes(axes: Axes, group: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> None:
    """How far parameters of one kind, none prescribed as zero, moved from their prescribed values, in percent."""
    prescribed = np.array([given.believed for given in group])
    estimate, lower, upper, truth = 100.0 * (_values(group, true) / prescribed - 1.0)
    axes.axhline(0.0, color=style.GREY, linewidth=0.7, linestyle="--", zorder=1, label="prescribed")
    _draw_estimates(axes, _connections(group), estimate, lower, upper)
    _draw_truth(axes, _connections(group), truth)
    _dress(axes, _connections(group))
    _name_connections(axes, group)


def _values(group: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> np.ndarray:
    """(4, parameters): estimate, ends of its interval, truth; NaN where unknown."""
    rows = [(given.estimate, given.lower_90, given.upper_90, true_value(given.parameter, true)) for given in group]
    return np.array(rows, dtype=float).T


def _connections(group: Sequence[ParameterEstimate]) -> np.ndarray:
    """Where the parameters of one kind stand on the axis: at their numbers, those with names side by side."""
    if group[0].parameter.label:
        return np.arange(1, len(group) + 1)
    return np.array([given.parameter.index + 1 for given in group])


def _extent(values: np.ndarray) -> tuple[float, float]:
    """Least and largest value, apart even where all are equal."""
    bottom, top = float(np.nanmin(values)), float(np.nanmax(values))
    least = 1e-6 * max(abs(bottom), abs(top)) or 1.0
    return (bottom, top) if top - bottom > least else (bottom - least, top + least)


def _draw_estimates(
    axes: Axes, connection: np.ndarray, estimate: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> None:
    look: dict[str, Any] = {"color": style.VERMILLION, "markersize": 3, "zorder": 3}
    bars: dict[str, Any] = {"elinewidth": 0.9, "capsize": 2, "capthick": 0.9}
    # The interval stands on its own: a prescribed value below zero turns a relative one round.
    middle, reach = (lower + upper) / 2.0, np.abs(upper - lower) / 2.0
    axes.plot(connection, estimate, "o", **look, label="" if np.isfinite(reach).any() else "estimate")
    if np.isfinite(reach).any():
        axes.errorbar(connection, middle, yerr=reach, fmt="none", ecolor=style.VERMILLION, zorder=3, **bars)
        axes.errorbar([], [], yerr=[], fmt="o", **look, **bars, label="estimate, 90 % interval")


def _draw_truth(axes: Axes, connection: np.ndarray, truth: np.ndarray) -> None:
    if np.isfinite(truth).any():
        axes.plot(
            connection, truth, linestyle="none", marker="D", markersize=4.5, markerfacecolor="none",
            markeredgecolor=style.BLACK, markeredgewidth=0.8, zorder=2, label="truth",
        )  # fmt: skip


def _point_to_start(axes: Axes, connection: np.ndarray, start: np.ndarray, arrow: str, height: float) -> None:
    """Arrows at an edge of the panel, with the value that they point to; equal ones in a row say it once."""
    if not start.size:
        return
    axes.plot(
        connection, np.full(start.size, height), transform=axes.get_xaxis_transform(), linestyle="none", marker=arrow,
        markersize=3.5, color=style.GREY, zorder=1, label="start, off the scale",
    )  # fmt: skip
    for i, (x, value) in enumerate(zip(connection, start, strict=True)):
        if i == 0 or value != start[i - 1]:
            axes.annotate(
                f"{value:.4g}", (x, height), xycoords=axes.get_xaxis_transform(), xytext=(4, 0),
                textcoords="offset points", va="center", fontsize=6.5, color=style.GREY,
            )  # fmt: skip


def _name_connections(axes: Axes, group: Sequence[ParameterEstimate]) -> None:
    """Names instead of numbers, upright so that long ones do not meet."""
    names = [given.parameter.label for given in group]
    if names[0]:
        every = -(-len(names) // NAMED)
        axes.set_xticks(_connections(group)[::every], names[::every], rotation=90)
        axes.set_xlabel("")


def _dress(axes: Axes, connection: np.ndarray) -> None:
    axes.set_xlim(connection.min() - 0.6, connection.max() + 0.6)
    axes.set_xlabel("Connection $i$", labelpad=2)
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True, min_n_ticks=1))
    axes.yaxis.set_major_locator(MaxNLocator(6))
