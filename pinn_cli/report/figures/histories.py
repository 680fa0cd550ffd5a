"""Histories in panels: the estimate, its band, and what there is to compare it with, drawn alike everywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from pinn_cli.report.estimates import Histories
from pinn_cli.report.figures import style

BAND = 1.96  # standard deviations to either side of the estimate: 95 %
POINTS = 400  # observations drawn in a panel at most
PERIODS_IN_FULL, PERIODS_SHOWN = 100, 20  # a longer record shows a stretch, else it is a block of ink

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
            every = np.arange(0, len(time), thinned(len(time)))
            kept = every if source == "observed" else style.line_indices(np.nan_to_num(values))
            axes.plot(time[kept], values[kept], **look)
    axes.set_xlim(time[0], time[-1])
    style.ticks(axes)


def draw_column(panels: np.ndarray, each: Histories, places: Sequence[int], window: slice, looks: Looks) -> float:
    """A panel for each place, with the time below and the quantity above; the factor to the unit that is shown.

    Forces have one scale, so that one that should not be there is seen in proportion.
    """
    ends = np.array([limits(each, place, window) for place in places])
    if each.name == "force":
        ends[:] = [np.nanmin(ends[:, 0]), np.nanmax(ends[:, 1])] if np.isfinite(ends).any() else [-1.0, 1.0]
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(ends), initial=0.0)), kilo=each.name == "force")
    for axes, place, (low, high) in zip(panels, places, ends, strict=True):
        known = np.isfinite(each.of("true")[window, place]).all()
        # Dashes let the truth show through; alone, the estimate has nothing to let through.
        solid = looks if known else {**looks, "estimate": {**looks["estimate"], "linestyle": "-"}}
        draw(axes, each, place, window, factor, solid)
        if np.isfinite(low):
            axes.set_ylim(factor * low, factor * high)
        axes.tick_params(labelbottom=axes is panels[-1])
    title = f"{each.words.capitalize()} {style.SYMBOLS.get(each.name, '')}".strip()
    panels[0].set_title(f"{title} ({prefix}{each.unit.replace('^2', style.SQUARED)})", pad=4)
    panels[-1].set_xlabel(r"Time $t$ (s)", labelpad=2)
    return factor


def band(histories: Histories, place: int, window: slice) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge: those that were found, or 1.96 standard deviations about the estimate; NaN of neither."""
    if "lower" in histories.found:
        return histories.found["lower"][window, place], histories.found["upper"][window, place]
    estimate, spread = histories.of("estimate")[window, place], BAND * histories.of("std")[window, place]
    return estimate - spread, estimate + spread


def limits(histories: Histories, place: int, window: slice) -> tuple[float, float]:
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
    return -(-samples // POINTS)


def periods_of(histories: np.ndarray) -> float:
    """How many periods histories (N, n) have, the median of all: half the changes of sign."""
    signs = np.signbit(histories)
    return float(np.median((signs[1:] != signs[:-1]).sum(axis=0))) / 2.0


def window_about(
    middle: int, samples: int, periods: float, shown: int = PERIODS_SHOWN, in_full: int = PERIODS_IN_FULL
) -> slice:
    """The samples of a few periods about one of them, or all of a record that has no more than ``in_full`` periods."""
    if periods <= in_full:
        return slice(0, samples)
    half = max(int(samples * shown / periods / 2.0), 1)
    middle = min(max(middle, half), max(samples - 1 - half, half))
    return slice(middle - half, middle + half + 1)
