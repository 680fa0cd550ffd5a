"""Whether the chains of a sampler agree: traces, and ranks chain by chain."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from pinn_cli.report.figures import style
from pinn_cli.report.figures.parameter_axis import ParameterAxis

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from pinn_cli.posterior.samples import PosteriorSamples

PARAMETERS_SHOWN = 12
POINTS = 500  # of a chain, evenly thinned: an outline of lowest and highest would hide how a chain wanders
RANK_BINS = 20

_COLUMNS = 2
_LEFT, _RIGHT, _TOP, _BOTTOM, _NOTE = 0.62, 0.17, 0.3, 0.4, 0.14  # inch; the last of a line at the foot
_ACROSS, _DOWN = 0.75, 0.1  # inch, between panels


def trace_figure(
    samples: PosteriorSamples, units: Mapping[str, str] | None = None, shown: Sequence[str] | None = None
) -> Figure:
    """One panel per parameter: its draws over the iterations after warm-up, chain by chain.

    Divergent iterations are marked at the foot of every panel. At most `POINTS` draws of a chain are drawn.

    Args:
        samples: (chains, draws, p).
        units: Symbol to its unit, powers as ``m^3``.
        shown: Names of the parameters that have a panel; None for the first `PARAMETERS_SHOWN`.
    """
    chains, count = samples.draws.shape[:2]
    every = -(-count // POINTS)
    iterations = samples.warmup + 1 + np.arange(0, count, every)
    diverging = samples.statistics.get("diverging", np.zeros((chains, count), dtype=bool)).astype(bool)
    with style.look():
        figure, panels, positions = _panels(samples, shown, row=0.85)
        for panel, i in zip(panels, positions, strict=True):
            axis = ParameterAxis.around(
                samples.names[i], samples.draws[..., i].ravel(), math.nan, units or {}, tail=0.0
            )
            for chain in range(chains):
                colour = style.CYCLE[chain % len(style.CYCLE)]
                panel.plot(iterations, samples.draws[chain, ::every, i], color=colour, linewidth=0.4, alpha=0.8)
            axis.dress(panel.yaxis, panel.bbox.height / figure.dpi, 7.0)
            panel.set_ylabel(axis.label)
            panel.set_xlim(samples.warmup + 1, samples.warmup + max(count, 2))
            _mark(panel, samples.warmup + 1 + np.flatnonzero(diverging.any(axis=0)))
        _finish(figure, panels, "Iteration", samples, len(positions))
        _legend(figure, chains, int(diverging.sum()))
    return figure


def rank_figure(samples: PosteriorSamples, shown: Sequence[str] | None = None) -> Figure:
    """One panel per parameter: where each chain's draws stand among those of all, as one histogram per chain.

    Chains that explore the same distribution have flat histograms, at the dashed lines (Vehtari, Gelman, Simpson,
    Carpenter and Buerkner, Bayesian Analysis 16, 2021, section 4.2). A single chain is compared with itself, its first
    half with its second.

    Args:
        samples: (chains, draws, p), at least two draws.
        shown: Names of the parameters that have a panel; None for the first `PARAMETERS_SHOWN`.
    """
    draws, kind = samples.draws, "chain"
    if len(draws) == 1:
        half = draws.shape[1] // 2
        draws, kind = draws[0, : 2 * half].reshape(2, half, -1), "half"
    with style.look():
        figure, panels, positions = _panels(samples, shown, row=0.3 + 0.2 * min(len(draws), 8))
        for panel, i in zip(panels, positions, strict=True):
            _draw_ranks(panel, draws[..., i])
            panel.set_ylabel(f"{style.parameter_symbol(samples.names[i])}, {kind}")
        _finish(figure, panels, "Rank among all draws", samples, len(positions))
        flat = Line2D([], [], color=style.BLACK, linewidth=0.6, linestyle="--", label="chains that agree")
        figure.legend(handles=[flat], loc="upper center", bbox_to_anchor=(0.5, 1.0))
    return figure


def ranks(draws: np.ndarray) -> np.ndarray:
    """The rank of every draw among all of ``draws``, from 1, of its shape; equal ones share their mean rank."""
    from scipy.stats import rankdata

    shared: np.ndarray = rankdata(draws, axis=None).reshape(draws.shape)
    return shared


def _draw_ranks(panel: Axes, draws: np.ndarray) -> None:
    chains, count = draws.shape
    edges = np.linspace(0.5, draws.size + 0.5, RANK_BINS + 1)
    expected = count / RANK_BINS
    for chain, ranked in enumerate(ranks(draws)):
        floor = chain + 0.6
        height = np.minimum(0.4 * np.histogram(ranked, edges)[0] / expected, 0.85)
        colour = style.CYCLE[chain % len(style.CYCLE)]
        panel.stairs(floor + height, edges, baseline=floor, fill=True, color=colour, alpha=0.75, linewidth=0)
        panel.hlines(floor + 0.4, *edges[[0, -1]], color=style.BLACK, linewidth=0.6, linestyle="--")
    panel.set(xlim=edges[[0, -1]], ylim=(0.5, chains + 0.55))
    panel.set_yticks(np.arange(1, chains + 1, -(-chains // 8)))
    panel.tick_params(axis="y", length=0)


def _panels(samples: PosteriorSamples, shown: Sequence[str] | None, row: float) -> tuple[Figure, list[Axes], list[int]]:
    """A panel of height ``row`` (inch) for each shown parameter, column by column; and the parameters' positions."""
    positions = [samples.names.index(name) for name in (samples.names if shown is None else shown)][:PARAMETERS_SHOWN]
    columns = min(_COLUMNS, len(positions))
    rows = -(-len(positions) // columns)
    bottom = _BOTTOM + (_NOTE if len(positions) < len(samples.names) else 0.0)
    height = _TOP + rows * (row + _DOWN) - _DOWN + bottom
    figure = Figure(figsize=(style.PAGE_WIDTH if columns > 1 else 0.6 * style.PAGE_WIDTH, height))
    width = figure.get_figwidth()
    panel_width = (width - _LEFT - _RIGHT - (columns - 1) * _ACROSS) / columns
    grid = figure.add_gridspec(
        rows,
        columns,
        left=_LEFT / width,
        right=1.0 - _RIGHT / width,
        top=1.0 - _TOP / height,
        bottom=bottom / height,
        wspace=_ACROSS / panel_width,
        hspace=_DOWN / row,
    )
    panels = list(np.asarray(grid.subplots(squeeze=False)).ravel())
    for unused in panels[len(positions) :]:
        unused.remove()
    return figure, panels[: len(positions)], positions


def _mark(panel: Axes, iterations: np.ndarray) -> None:
    if len(iterations):
        place = panel.get_xaxis_transform()
        panel.plot(iterations, np.full(len(iterations), 0.02), "|", color="red", markersize=5, transform=place)


def _finish(figure: Figure, panels: list[Axes], label: str, samples: PosteriorSamples, shown: int) -> None:
    lowest = panels[-_COLUMNS:]
    for panel in panels:
        panel.xaxis.set_major_locator(MaxNLocator(5, integer=True, steps=[1, 2, 5, 10]))
        panel.tick_params(labelbottom=panel in lowest)
    for panel in lowest:
        panel.set_xlabel(label)
    figure.align_ylabels(panels)
    if shown < len(samples.names):
        note = f"{shown} of {len(samples.names)} parameters"
        figure.text(0.99, 0.03 / figure.get_figheight(), note, ha="right", va="bottom", fontsize=7)


def _legend(figure: Figure, chains: int, divergent: int) -> None:
    handles = [
        Line2D([], [], color=style.CYCLE[chain % len(style.CYCLE)], linewidth=1.2, label=f"chain {chain + 1}")
        for chain in range(min(chains, len(style.CYCLE)))
    ]
    if divergent:
        mark = f"{divergent} divergent"
        handles.append(Line2D([], [], color="red", marker="|", linestyle="none", markersize=6, label=mark))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
