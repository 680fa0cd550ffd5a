"""Estimated system parameters with their 90 % intervals, relative to what was prescribed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.report.parameters import split_name, true_value

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from pinn_cli.training.estimate import ParameterEstimate

_NAMES = {
    "m": "Mass $m$",
    "c": "Damping $c$",
    "k": "Stiffness $k$",
    "kappa": r"Duffing $\kappa$",
    "mu": r"Van der Pol $\mu$",
}


def parameters_figure(estimates: Sequence[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> Figure:
    """One panel per symbol: the relative change from the prescribed value of every connection, and its 90 % interval.

    Args:
        estimates: At least one; a prescribed value of zero has no relative change and is left out.
        true: Symbol to values (dof,), marked where known; or None.

    Raises:
        ValueError: If there is nothing to draw.
    """
    by_symbol: dict[str, list[ParameterEstimate]] = {}
    for given in estimates:
        if given.prescribed:
            by_symbol.setdefault(split_name(given.name)[0], []).append(given)
    if not by_symbol:
        raise ValueError("there is no estimated parameter with a prescribed value other than zero")
    with style.look():
        figure = Figure(figsize=(min(1.2 + 2.0 * len(by_symbol), style.PAGE_WIDTH), 2.3))
        width = figure.get_figwidth()
        grid = figure.add_gridspec(
            1, len(by_symbol), left=0.55 / width, right=1.0 - 0.08 / width, top=0.78, bottom=0.17, wspace=0.28
        )
        panels = grid.subplots(squeeze=False)[0]
        for axes, (symbol, group) in zip(panels, by_symbol.items(), strict=True):
            _draw_symbol(axes, group, true)
            axes.set_title(_NAMES.get(symbol, symbol), pad=4)
        panels[0].set_ylabel("Change from prescribed (%)")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
    return figure


def _draw_symbol(axes: Axes, group: list[ParameterEstimate], true: Mapping[str, np.ndarray] | None) -> None:
    connection = np.array([split_name(given.name)[1] for given in group])
    relative = np.array(
        [
            [
                value / given.prescribed - 1.0
                for value in (given.estimate, given.lower_90, given.upper_90, true_value(given.name, true))
            ]
            for given in group
        ]
    )
    estimate, lower, upper, truth = 100.0 * relative.T
    axes.axhline(0.0, color=style.GREY, linewidth=0.7, linestyle="--", zorder=1, label="prescribed")
    # A prescribed value below zero turns the interval round.
    reach = np.abs(np.sort(np.stack([lower, upper]), axis=0) - estimate)
    axes.errorbar(
        connection, estimate, yerr=np.nan_to_num(reach), fmt="o", color=style.VERMILLION, markersize=3, elinewidth=0.9,
        capsize=2, capthick=0.9, zorder=3, label="estimate, 90 % interval",
    )  # fmt: skip
    if np.isfinite(truth).any():
        axes.plot(
            connection, truth, linestyle="none", marker="D", markersize=4.5, markerfacecolor="none",
            markeredgecolor=style.BLACK, markeredgewidth=0.8, zorder=2, label="truth",
        )  # fmt: skip
    axes.set_xlim(connection.min() - 0.6, connection.max() + 0.6)
    axes.set_xlabel("Connection $i$", labelpad=2)
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True, min_n_ticks=1))
    axes.yaxis.set_major_locator(MaxNLocator(6))
