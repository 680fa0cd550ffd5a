"""Figures of a sampled posterior: pairs of parameters, traces and ranks of the chains; the fitted force."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # its `stats` is imported where it is first named: half a second
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from pinn_cli.posterior.posterior import ForcePredictive, two_chains
from pinn_cli.record.record import Record
from pinn_cli.report.estimates import Histories
from pinn_cli.report.figures import histories, style
from pinn_cli.report.figures.parameters import write_correlation
from pinn_cli.report.parameters import posterior_correlation, true_value
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.reported.parameter_posterior import CENTRAL_90

if TYPE_CHECKING:
    import xarray as xr

IN_PAIRS, IN_TRACES, CHAINS_SHOWN = 8, 12, 8  # parameters in either figure, and chains, at most
REGIONS = (0.9, 0.7, 0.5, 0.3, 0.1)
DENSITY_DRAWS, DENSITY_GRID = 1000, 50  # of a joint density: draws that it is worked out from, places along an axis
RANK_BINS = 20
TAIL = 0.0005  # one draw in a thousand may widen an axis to no purpose
SPAN_MARGIN = 0.06  # of the span, on either side
TRUTH_WITHIN = 2.0  # spans: a truth that is further off is left out, else the draws would be a line
FORCE_PERIODS_SHOWN = 10  # of the fitted force

_TRUE_LINE: style.Look = {"color": style.BLACK, "linewidth": 0.8, "linestyle": (0, (4, 2)), "label": "true value"}
_BLUES = [to_hex(colour) for colour in colormaps["Blues"](np.linspace(0.22, 0.95, len(REGIONS)))]
_TAILS, _BARS = _BLUES[0], _BLUES[2]


@style.look()
def posterior_pairs_figure(
    draws: xr.Dataset, parameters: Sequence[Parameter], true: Mapping[str, np.ndarray] | None = None
) -> Figure:
    """Histograms on the diagonal, joint densities below it, correlations above it; true values as dashed lines.

    A histogram is pale outside the central 90 % interval. The contours of a joint density hold the `REGIONS` of
    highest density. Chains are taken together. Of more than `IN_PAIRS` parameters, those are shown that are most
    correlated with another one, and a line below says so; one whose draws are all the same is left out. ``draws`` has a
    variable over (chain, draw) for every parameter, ``true`` values (members,) by kind, marked unless they are far off.
    """
    moving = _moving(draws, parameters)
    pooled = {p: draws[p.name].to_numpy().ravel() for p in moving}
    correlation = posterior_correlation(np.stack(list(pooled.values()), axis=-1))
    order = most_correlated(correlation, IN_PAIRS)
    shown = [moving[i] for i in order]
    limits = {p: _limits(pooled[p], true_value(p, true)) for p in shown}
    side = min((style.PAGE_WIDTH - 0.7) / len(shown), 1.7) - 0.05  # inch
    width = max(0.7 + len(shown) * (side + 0.05), 3.0)
    left = 0.62 + (width - 0.7 - len(shown) * (side + 0.05)) / 2.0
    figure, panels = style.panels(
        len(shown), len(shown), side, width=width, margins=(left, left - 0.54, 0.3, 0.42), gaps=(0.05, 0.05)
    )
    for row, vertical in enumerate(shown):
        _draw_histogram(panels[row, row], pooled[vertical])
        for column, horizontal in enumerate(shown[: row + 1]):
            if column < row:
                _draw_density(panels[row, column], pooled[horizontal], pooled[vertical])
                panels[column, row].remove()
            _dress_axis(panels[row, column].xaxis, pooled[horizontal], horizontal, *limits[horizontal])
            if column < row:
                _dress_axis(panels[row, column].yaxis, pooled[vertical], vertical, *limits[vertical])
                value = correlation[order[row], order[column]]
                panel = figure.add_subplot(panels[0, 0].get_gridspec()[column, row])
                panel.set(xticks=[], yticks=[], facecolor=colormaps["RdBu_r"](0.5 + 0.5 * value))
                # Two decimals; more, up to four, rather than a 1 that is none.
                decimals = next((n for n in (2, 3, 4) if abs(round(value, n)) < 1.0), 2)
                text = f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0: no minus before a 0
                write_correlation(panel, (0.5, 0.5), value, text, transform=panel.transAxes)
            panels[row, column].label_outer()
    handles: list[Line2D | Patch] = [Patch(color=_BARS, linewidth=0, label="90 % interval")]
    if len(shown) > 1:
        regions = f"regions holding {', '.join(f'{100 * share:.0f}' for share in reversed(REGIONS))} %"
        handles.append(Patch(facecolor=_BLUES[1], edgecolor=style.BLUE, linewidth=0.5, label=regions))
    handles += [Line2D([], [], **_TRUE_LINE)] if any(math.isfinite(value) for _, value in limits.values()) else []
    note = f"the {len(shown)} of {len(moving)} parameters that are most correlated with another"
    _finish(figure, handles, note if len(shown) < len(moving) else "")
    return figure


def _draw_histogram(panel: Axes, values: np.ndarray) -> None:
    """Of draws (draws,), pale outside the central 90 % interval."""
    lower, upper = np.quantile(values, CENTRAL_90)
    counts, edges = np.histogram(values, bins=40)
    middles = (edges[1:] + edges[:-1]) / 2.0
    colours = [_BARS if lower <= middle <= upper else _TAILS for middle in middles]
    panel.bar(edges[:-1], counts, np.diff(edges), align="edge", color=colours)
    panel.set(yticks=[])


def _draw_density(panel: Axes, across: np.ndarray, up: np.ndarray) -> None:
    """Contours of the joint density of draws (draws,) that hold the `REGIONS`; draws on one line are dots."""
    drawn = np.stack((across, up))[:, :: -(-len(across) // DENSITY_DRAWS)]
    try:
        density = scipy.stats.gaussian_kde(drawn)
    except np.linalg.LinAlgError:
        panel.plot(*drawn, ".", color=_BARS, markersize=1.0)
        return
    margins = 0.1 * np.ptp(drawn, axis=1)
    grid = np.linspace(drawn.min(axis=1) - margins, drawn.max(axis=1) + margins, DENSITY_GRID).T
    heights = density(np.stack(np.meshgrid(*grid)).reshape(2, -1)).reshape(DENSITY_GRID, DENSITY_GRID)
    # What is denser than a tenth of the draws are is the region that holds 90 %.
    levels = np.unique(np.quantile(density(drawn), 1.0 - np.asarray(REGIONS)))
    panel.contourf(*grid, heights, levels=levels, colors=_BLUES, extend="max")
    panel.contour(*grid, heights, levels=levels[:1], colors=[style.BLUE], linewidths=0.5)


def _limits(values: np.ndarray, true: float) -> tuple[tuple[float, float], float]:
    """Of the axis on which draws (draws,) and, if it is not far from them, the true value are seen; and that value."""
    lower, upper = np.quantile(values, (TAIL, 1.0 - TAIL))
    span = (upper - lower) or 1.0
    if not lower - TRUTH_WITHIN * span <= true <= upper + TRUTH_WITHIN * span:
        true = math.nan
    lower, upper = np.fmin(lower, true), np.fmax(upper, true)
    margin = SPAN_MARGIN * ((upper - lower) or 1.0)
    return (float(lower - margin), float(upper + margin)), true


def _dress_axis(
    axis: Axis, values: np.ndarray, parameter: Parameter, limits: tuple[float, float] | None = None,
    true: float = math.nan,
) -> None:  # fmt: skip
    """Limits, a few ticks, a line at the true value where that is finite, and the symbol with its unit.

    For values from 10 000 on or below 0.01 there is a power of a thousand in the unit.
    """
    horizontal, panel = isinstance(axis, XAxis), axis.axes
    if limits is not None:
        (panel.set_xlim if horizontal else panel.set_ylim)(*limits)
    if math.isfinite(true):
        (panel.axvline if horizontal else panel.axhline)(true, **_TRUE_LINE)
    magnitude = float(np.abs(values).max())
    power = 0 if 1e-2 <= magnitude < 1e4 or magnitude == 0.0 else 3 * math.floor(math.log10(magnitude) / 3.0)
    unit = [rf"$10^{{{power}}}$"] * bool(power) + [style.raised(parameter.unit)] * bool(parameter.unit)
    axis.set_label_text(f"{parameter.symbol} ({' '.join(unit)})" if unit else parameter.symbol, fontsize=8)
    low, high = axis.get_view_interval()
    grid = panel.get_gridspec()
    few = grid is None or grid.ncols < 7
    ticks = np.asarray(MaxNLocator(4 if few else 3, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    # A label at an end would run into the next panel's.
    axis.set_major_locator(FixedLocator(list(ticks[np.abs(ticks - (low + high) / 2.0) < 0.4 * (high - low)])))
    if power:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value * 10.0**-power:g}"))
    axis.set_tick_params(labelsize=7 if few else 6)


def most_correlated(correlation: np.ndarray, most: int) -> list[int]:
    """Positions of the parameters of the most correlated pairs (p, p), ``most`` of them at most, in their order."""
    rows, columns = np.triu_indices(len(correlation), 1)
    strongest = np.argsort(-np.abs(correlation[rows, columns]), kind="stable")
    pairs = np.stack((rows[strongest], columns[strongest]), axis=1).ravel().tolist()
    return sorted([*dict.fromkeys((*pairs, *range(len(correlation))))][:most])


@style.look()
def trace_figure(draws: xr.Dataset, statistics: xr.Dataset, parameters: Sequence[Parameter], number: int) -> Figure:
    """One row per parameter: its density and its draws over the iterations after warm-up, chain by chain.

    Divergent iterations are marked at the foot of every trace. ``draws`` and ``statistics`` are the groups
    ``posterior``, whose attribute ``tuning_steps`` counts the iterations of the warm-up, and ``sample_stats``;
    ``parameters`` have a row, of ``number`` in all.
    """
    count, shown = draws.sizes["chain"], _moving(draws, parameters)
    iteration = draws["draw"].to_numpy() + 1 + draws.attrs.get("tuning_steps", 0)
    divergent = (
        iteration[np.nonzero(statistics["diverging"].to_numpy())[1]] if "diverging" in statistics else iteration[:0]
    )
    mark: style.Look = {"color": "k", "marker": "|", "linestyle": "none", "markersize": 6}
    figure, panels = _rows(len(shown), 0.8, width_ratios=(1, 3))
    for (density, trace), parameter in zip(panels, shown, strict=True):
        chains = draws[parameter.name].to_numpy()[:CHAINS_SHOWN]
        for chain, colour in zip(chains, cycle(style.CYCLE), strict=False):
            if chain.min() < chain.max():
                places = np.linspace(chain.min(), chain.max(), DENSITY_GRID)
                density.plot(places, scipy.stats.gaussian_kde(chain)(places), color=colour, linewidth=0.8)
            trace.plot(iteration, chain, color=colour, alpha=0.8, linewidth=0.4, rasterized=True)
        for axis in (trace.yaxis, density.xaxis):
            _dress_axis(axis, chains, parameter)
        density.set(yticks=[], ylim=(0.0, None), xlabel="", ylabel=trace.get_ylabel())
        trace.set(ylabel="", xlim=(iteration[0], iteration[-1]))
        trace.tick_params(labelbottom=trace is panels[-1, 1])
        trace.plot(divergent, np.full(len(divergent), trace.get_ylim()[0]), **mark)
    panels[-1, 1].set_xlabel("Iteration")
    named = [Line2D([], [], color=c, label=f"chain {i}") for i, c in enumerate(style.CYCLE[:count], start=1)]
    marked = Line2D([], [], **mark, label=f"{len(divergent)} divergent")
    _finish(figure, [*named, *[marked][: len(divergent)]], _left_out(shown, number))
    return figure


@style.look()
def rank_figure(draws: xr.Dataset, parameters: Sequence[Parameter], number: int) -> Figure:
    """One panel per parameter: where each chain's draws stand among those of all, as one histogram per chain.

    Chains that explore the same distribution have flat histograms, at the dashed lines (Vehtari, Gelman, Simpson,
    Carpenter and Buerkner, Bayesian Analysis 16, 2021, section 4.2). A single chain is compared with itself, its first
    half with its second.

    Arguments are those of :func:`trace_figure`; there are at least two draws of every chain.
    """
    shown, kind = _moving(draws, parameters), "half" if draws.sizes["chain"] == 1 else "chain"
    compared = {p.name: two_chains(draws[p.name].to_numpy())[:CHAINS_SHOWN] for p in shown}
    chains = len(compared[shown[0].name])
    figure, panels = _rows(-(-len(shown) // 2), 0.3 + 0.2 * chains)
    for panel, parameter in zip(panels.ravel(), shown, strict=False):
        _draw_ranks(panel, compared[parameter.name])
        panel.set(ylabel=f"{parameter.symbol}, {kind}")
    for panel in panels.ravel()[len(shown) :]:
        panel.remove()
    figure.supxlabel("Rank among all draws", fontsize=8, y=0.01)
    flat = Line2D([], [], color=style.BLACK, linewidth=0.6, linestyle="--", label="chains that agree")
    _finish(figure, [flat], _left_out(shown, number))
    return figure


def _moving(draws: xr.Dataset, parameters: Sequence[Parameter]) -> list[Parameter]:
    """The parameters whose draws are not all the same; all of them where none moves."""
    return [p for p in parameters if draws[p.name].min() < draws[p.name].max()] or list(parameters)


def _rows(count: int, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
    """Rows of two panels each, of that height (inch)."""
    return style.panels(count, 2, height, margins=(0.5, 0.15, 0.3, 0.42), gaps=(0.5, 0.2), **options)


def _left_out(shown: Sequence[Parameter], number: int) -> str:
    return f"{len(shown)} of {number} parameters" if len(shown) < number else ""


def _finish(figure: Figure, handles: Sequence[Line2D | Patch], note: str) -> None:
    figure.align_labels()
    figure.legend(handles=list(handles), loc="upper center", ncols=len(handles), handlelength=2.2)
    style.note(figure, note)


def _draw_ranks(panel: Axes, chains: np.ndarray) -> None:
    """Histograms of the ranks of draws (chains, draws) among all, one above the other; dashed where all are alike."""
    edges = np.linspace(0.5, chains.size + 0.5, RANK_BINS + 1)
    counts = np.stack([np.histogram(ranks, edges)[0] for ranks in scipy.stats.rankdata(chains).reshape(chains.shape)])
    feet = 1.1 * counts.max() * np.arange(len(chains))
    for foot, heights, colour in zip(feet, counts, cycle(style.CYCLE), strict=False):
        panel.bar(edges[:-1], heights, np.diff(edges), foot, align="edge", color=colour, alpha=0.75, linewidth=0.0)
        panel.axhline(foot + chains.shape[1] / RANK_BINS, color=style.BLACK, linewidth=0.6, linestyle="--")
    panel.set_yticks(feet + chains.shape[1] / RANK_BINS, [f"{i}" for i in range(1, len(chains) + 1)])


@style.look()
def force_predictive_figure(predictive: ForcePredictive, record: Record, dofs: np.ndarray) -> Figure:
    """One row per measured force: observed dots, predictive median and central 90 % band, on a stretch of the record.

    What share of the observations lies in the band, at all times that were predicted, is written in each panel: about
    90 % if model and noise are right. ``dofs`` (F,) are counted from 1; of many, as many rows are drawn as the response
    has.
    """
    observed = record.force[np.ix_(predictive.samples, dofs - 1)]
    lower, median, upper = np.quantile(predictive.force, (CENTRAL_90[0], 0.5, CENTRAL_90[1]), axis=(0, 1))
    sources = {"estimate": median, "lower": lower, "upper": upper, "observed": observed}
    places = tuple(record.dof_name(dof - 1) for dof in dofs)
    forces = Histories("force", "dof", places, record.time[predictive.samples], sources)
    held = np.mean((observed >= lower) & (observed <= upper), axis=0)
    rows = histories.shown_dofs(len(dofs))
    window = histories.window_about(len(median) // 2, median[:, rows], FORCE_PERIODS_SHOWN, FORCE_PERIODS_SHOWN)
    looks = histories.looks(estimate="predictive median", band="90 % band", observed="observed")
    looks["observed"] |= {"color": style.BLACK, "zorder": 2.3}
    figure, panels = style.panels(len(rows), 1, 1.25, margins=(0.55, 0.1, 0.5, 0.4), gaps=(0.0, 0.12), sharex=True)
    histories.draw_column(panels[:, 0], forces, rows, window, looks)
    for axes, row in zip(panels[:, 0], rows, strict=True):
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.15 * (high - low))  # room for the text above
        axes.set_ylabel(f"DOF {places[row]}")
        share = f"band holds {100.0 * held[row]:.0f} % of the observations"
        axes.text(0.995, 0.96, share, transform=axes.transAxes, ha="right", va="top", fontsize=7)
    figure.align_ylabels(list(panels[:, 0]))
    style.legend(figure, markerscale=1.5)
    return figure
