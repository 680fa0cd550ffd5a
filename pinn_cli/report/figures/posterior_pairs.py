"""Every pair of parameters of a sampled posterior: the layout of the paper's Figures 13 and 14."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pinn_cli.report.figures import style
from pinn_cli.report.figures.highest_density import grid_density, mass_levels
from pinn_cli.report.figures.parameter_axis import ParameterAxis
from pinn_cli.report.parameters import true_value
from pinn_cli.report.posterior_table import posterior_correlation
from pinn_cli.training.central_interval import CENTRAL_90

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes

    from pinn_cli.posterior.samples import PosteriorSamples

PARAMETERS_SHOWN = 9  # as many as a page has room for
REGIONS = (0.9, 0.7, 0.5, 0.3, 0.1)  # of the draws, held by the contours from the outside in
BINS = 32

_LEFT, _RIGHT, _TOP, _BOTTOM, _NOTE, _GAP = 0.62, 0.06, 0.3, 0.38, 0.15, 0.05  # inch
_CELL, _LEAST_WIDTH = 1.35, 4.6  # inch, of a cell at most and of the figure at least
_NOTED = "the {} of {} parameters that are most correlated with another"
_TRUE: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.9, "linestyle": (0, (4, 2))}
_CONTOURS = ListedColormap(colormaps["Blues"](np.linspace(0.22, 0.95, len(REGIONS))))
_TAILS, _BARS = _CONTOURS(0), _CONTOURS(2)


def posterior_pairs_figure(
    samples: PosteriorSamples, true: Mapping[str, np.ndarray] | None, units: Mapping[str, str] | None = None
) -> Figure:
    """Histograms on the diagonal, joint densities below it, correlations above it; true values as dashed lines.

    A histogram is pale outside the central 90 % interval. The contours of a joint density hold the `REGIONS` of
    highest density. Chains are taken together. Of more than `PARAMETERS_SHOWN` parameters, those are shown that are
    most correlated with another one, and a line below says so.

    Args:
        samples: At least one parameter.
        true: Symbol to values (dof,), marked where known; or None.
        units: Symbol to its unit, powers as ``m^3``.
    """
    correlation = posterior_correlation(samples)
    shown = most_correlated(correlation, PARAMETERS_SHOWN)
    draws = samples.draws.reshape(-1, len(samples.names))
    axes_of = [
        ParameterAxis.around(samples.names[i], draws[:, i], true_value(samples.names[i], true), units or {})
        for i in shown
    ]
    with style.look():
        note = "" if len(shown) == len(samples.names) else _NOTED.format(len(shown), len(samples.names))
        figure, panels, cell = _panels(len(shown), _BOTTOM + (_NOTE if note else 0.0))
        for row, i in enumerate(shown):
            _draw_marginal(panels[row, row], draws[:, i], axes_of[row])
            for column, j in enumerate(shown[:row]):
                _draw_joint(panels[row, column], draws[:, [j, i]], axes_of[column], axes_of[row])
                _write_correlation(panels[column, row], correlation[i, j], cell)
        _label(panels, axes_of, cell)
        _legend(figure, any(np.isfinite(axis.true) for axis in axes_of), len(shown) > 1)
        figure.text(0.99, 0.005, note, ha="right", va="bottom", fontsize=7)
    return figure


def most_correlated(correlation: np.ndarray, most: int) -> list[int]:
    """Positions of the parameters of the most correlated pairs, ``most`` of them at most, in increasing order.

    Args:
        correlation: (p, p).
        most: Where p is no larger, all are taken.
    """
    count = len(correlation)
    if count <= most:
        return list(range(count))
    rows, columns = np.triu_indices(count, 1)
    strength = np.nan_to_num(np.abs(correlation[rows, columns]), nan=-1.0)
    strongest = np.argsort(-strength, kind="stable")
    taken = dict.fromkeys(int(i) for pair in zip(rows[strongest], columns[strongest], strict=True) for i in pair)
    return sorted(list(taken)[:most])


def _panels(count: int, bottom: float) -> tuple[Figure, np.ndarray, float]:
    cell = min((style.PAGE_WIDTH - _LEFT - _RIGHT + _GAP) / count - _GAP, _CELL)
    side = count * (cell + _GAP) - _GAP
    width, height = max(_LEFT + side + _RIGHT, _LEAST_WIDTH), _TOP + side + bottom
    figure = Figure(figsize=(width, height))
    left = (width - side + _LEFT - _RIGHT) / 2.0
    grid = figure.add_gridspec(
        count,
        count,
        left=left / width,
        right=(left + side) / width,
        top=1.0 - _TOP / height,
        bottom=bottom / height,
        wspace=_GAP / cell,
        hspace=_GAP / cell,
    )
    return figure, np.asarray(grid.subplots(squeeze=False)), cell


def _draw_marginal(panel: Axes, values: np.ndarray, axis: ParameterAxis) -> None:
    edges = np.linspace(*axis.limits, BINS + 1)
    lower, upper = np.quantile(values, CENTRAL_90)
    inside = np.histogram(values[(values >= lower) & (values <= upper)], edges)[0]
    every = np.histogram(values, edges)[0]
    for counts, colour in ((every, _TAILS), (inside, _BARS)):
        panel.stairs(counts, edges, fill=True, color=colour, linewidth=0)
    panel.set(ylim=(0.0, 1.12 * every.max(initial=1)), yticks=[])
    if np.isfinite(axis.true):
        panel.axvline(axis.true, **_TRUE)


def _draw_joint(panel: Axes, pairs: np.ndarray, horizontal: ParameterAxis, vertical: ParameterAxis) -> None:
    x, y, density = grid_density(pairs, horizontal.limits, vertical.limits)
    levels = mass_levels(density, REGIONS)
    if np.all(np.diff(levels) > 0.0):  # else all draws lie in one place
        panel.contourf(x, y, density.T, levels=[*levels, 1.01 * density.max()], cmap=_CONTOURS)
        panel.contour(x, y, density.T, levels=levels[:1], colors=style.BLUE, linewidths=0.5)
    if np.isfinite(horizontal.true):
        panel.axvline(horizontal.true, **{**_TRUE, "linewidth": 0.6})
    if np.isfinite(vertical.true):
        panel.axhline(vertical.true, **{**_TRUE, "linewidth": 0.6})


def _write_correlation(panel: Axes, value: float, cell: float) -> None:
    panel.set(xticks=[], yticks=[])
    panel.patch.set_facecolor(colormaps["RdBu_r"](0.5 + 0.5 * value) if np.isfinite(value) else "#E6E6E6")
    text = correlation_text(value)
    colour = "white" if abs(value) > 0.65 else style.BLACK
    panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center", fontsize=6 + 3 * cell, color=colour)


def correlation_text(value: float) -> str:
    """Two decimals; more, up to four, rather than a 1 that is none."""
    if not np.isfinite(value):
        return "-"
    decimals = next((n for n in (2, 3, 4) if abs(round(value, n)) < 1.0), 2)
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "\N{MINUS SIGN}")  # + 0.0: no minus before a 0


def _label(panels: np.ndarray, axes_of: list[ParameterAxis], cell: float) -> None:
    """Limits of every panel, ticks and names at the left and at the bottom."""
    size = 7.0 if cell > 0.85 else 6.0
    count = len(axes_of)
    for row, vertical in enumerate(axes_of):
        for column, horizontal in enumerate(axes_of[: row + 1]):
            panel = panels[row, column]
            horizontal.dress(panel.xaxis, cell, size)
            if column < row:
                vertical.dress(panel.yaxis, cell, size)
            panel.tick_params(labelleft=column == 0 and row > 0, labelbottom=row == count - 1, pad=2)
    for column, axis in enumerate(axes_of):
        panels[-1, column].set_xlabel(axis.label, labelpad=size + 2, va="baseline", fontsize=size + 1)
        if count > 1:
            panels[column, 0].set_ylabel(axis.label, fontsize=size + 1)
    panels[0, 0].figure.align_ylabels(list(panels[:, 0]))


def _legend(figure: Figure, true: bool, joint: bool) -> None:
    handles: list[Line2D | Patch] = [Patch(color=_BARS, linewidth=0, label="90 % interval")]
    if joint:
        shares = ", ".join(f"{100 * share:.0f}" for share in reversed(REGIONS))
        handles.append(
            Patch(facecolor=_CONTOURS(1), edgecolor=style.BLUE, linewidth=0.5, label=f"regions holding {shares} %")
        )
    if true:
        handles.append(Line2D([], [], label="true value", **_TRUE))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles), handlelength=2.2)
