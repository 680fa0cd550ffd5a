"""Estimated response against the truth, DOF by DOF: the layout of the paper's Figures 4 to 8."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pinn_cli.record.response import GROUND, QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.report.figures.decimate import line_indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.training.estimate import Estimate

ROWS_IN_FULL = 6  # more DOFs than these: the first two and the last two, as in the paper
BAND = 1.96  # standard deviations to either side of the estimate: 95 %
POINTS = 400  # observations drawn in a panel at most
PERIODS_IN_FULL, PERIODS_SHOWN = 100, 20  # a longer record shows a stretch from its middle, else it is a block of ink


@dataclass(frozen=True)
class _Sources:
    """What is drawn: over one window of time, each a `Response` or (the record) something with the same arrays."""

    window: slice
    time: np.ndarray
    estimate: Response
    std: Response
    truth: Response | None
    linear: Response | None
    baseline: Response | None
    record: Record

    def column(self, source: str, quantity: str, dof: int) -> np.ndarray:
        """One line, (time,); all NaN where there is none."""
        response = getattr(self, source)
        values = None if response is None else getattr(response, quantity)
        if values is None:
            return np.full(len(self.time), np.nan)
        return values[self.window] if quantity == GROUND else values[self.window, dof]

    def measures(self, quantity: str, dof: int) -> bool:
        """Whether there is a sensor."""
        return quantity == GROUND or bool(self.record.sensors(quantity)[dof])


def response_figure(
    estimate: Estimate,
    record: Record,
    truth: Response | None,
    linear: Response | None = None,
    truth_label: str = "truth",
    baseline: tuple[str, Response] | None = None,
) -> Figure:
    """Rows are DOFs, an asterisk marks those without a response sensor; columns are u, its two time derivatives, and f.

    Where the ground moves, its acceleration stands in a last row.

    Args:
        estimate: The response at every DOF and its standard deviations (a band of 95 %; none where they are NaN or
            zero).
        record: The observations, drawn as points (at most `POINTS` of a channel).
        truth: Drawn as a line where it is known.
        linear: The true response of the equivalent linear system, drawn as a blue dash-dot line.
        truth_label: What the legend calls ``truth``: of a record from a rig it is a measurement.
        baseline: Name and response of another estimator, drawn as a green dotted line.

    The force has one scale for all DOFs, so that an estimated force where there is none is seen in proportion; its root
    mean square is written there.
    """
    name, other = baseline or ("", None)
    window = shown_window(record.time, estimate.response)
    sources = _Sources(window, record.time[window], estimate.response, estimate.std, truth, linear, other, record)
    dofs, shaken = shown_dofs(record.ndof), record.ground_acceleration is not None
    with style.look():
        margins = (0.62, 0.08, 0.48, 0.46)
        figure, panels = style.panels(len(dofs) + shaken, len(QUANTITIES), 0.645, margins=margins, gaps=(0.36, 0.077))
        for column, quantity in enumerate(QUANTITIES):
            _draw_column(panels[: len(dofs), column], sources, quantity, dofs)
        if shaken:
            _draw_ground(panels[-2:], sources)
        for row, dof in enumerate(dofs):
            panels[row, 0].set_ylabel(
                (record.dof_name(dof) if record.dofs else f"DOF {dof + 1}") + ("" if record.observed[dof] else "*")
            )
        figure.align_ylabels(list(panels[: len(dofs), 0]))
        _legend(figure, sources, dofs, {"truth": truth_label, "baseline": name.replace("_", " ")})
    return figure


def shown_dofs(ndof: int) -> list[int]:
    """The DOFs with a row, as indices from 0."""
    return list(range(ndof)) if ndof <= ROWS_IN_FULL else [0, 1, ndof - 2, ndof - 1]


def shown_window(time: np.ndarray, response: Response) -> slice:
    """The stretch of the record that is drawn: all of it, or a few periods of its middle if there are too many.

    A period is twice the mean distance of the velocity's changes of sign (the displacement's may ride on a drift).
    """
    periods, samples = periods_of(response.velocity), len(time)
    if periods <= PERIODS_IN_FULL:
        return slice(0, samples)
    half = int(samples * PERIODS_SHOWN / periods / 2.0)
    return slice(samples // 2 - half, samples // 2 + half + 1)


def periods_of(histories: np.ndarray) -> float:
    """How many periods histories (N, n) have, the median of all: half the changes of sign."""
    signs = np.signbit(histories)
    return float(np.median((signs[1:] != signs[:-1]).sum(axis=0))) / 2.0


def _draw_column(panels: np.ndarray, sources: _Sources, quantity: str, dofs: list[int]) -> None:
    limits = np.array([_limits(sources, quantity, dof) for dof in dofs])
    if quantity == "force":
        limits[:] = [np.nanmin(limits[:, 0]), np.nanmax(limits[:, 1])] if np.isfinite(limits).any() else [-1.0, 1.0]
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(limits), initial=0.0)), kilo=quantity == "force")
    for row, (axes, dof) in enumerate(zip(panels, dofs, strict=True)):
        _draw_lines(axes, sources, quantity, dof, factor)
        axes.set_xlim(sources.time[0], sources.time[-1])
        if np.isfinite(limits[row]).all():
            axes.set_ylim(*(limits[row] * factor))
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))
        axes.tick_params(labelbottom=row == len(dofs) - 1)
        if quantity == "force" and sources.record.unforced[dof]:
            _write_rms(axes, sources.column("estimate", quantity, dof))
    title = quantity.replace("_", " ").capitalize()
    panels[0].set_title(f"{title} {style.SYMBOLS[quantity]} ({style.unit(quantity, prefix)})", pad=4)
    panels[-1].set_xlabel(r"Time $t$ (s)", labelpad=2)


def _draw_ground(rows: np.ndarray, sources: _Sources) -> None:
    """The ground's acceleration in the last row, below those of the DOFs; its other panels stay empty."""
    column = QUANTITIES.index("acceleration")
    above, axes = rows[:, column]
    for empty in rows[-1, np.arange(len(QUANTITIES)) != column]:
        empty.set_axis_off()
    _draw_column(rows[-1:, column], sources, GROUND, [0])
    # There is no room between panels for a title and the times, which stand below.
    axes.text(0.03, 0.93, axes.get_title(), transform=axes.transAxes, va="top", fontsize=7)
    axes.set_title("")
    above.tick_params(labelbottom=False)
    above.set_xlabel("")


def _limits(sources: _Sources, quantity: str, dof: int) -> tuple[float, float]:
    """Lowest and highest value with a margin; NaN if there is nothing to draw.

    A wide band may triple the range, not more.
    """
    lines = [sources.column(name, quantity, dof) for name in ("estimate", "truth", "linear", "record")]
    stacked = np.concatenate([line[np.isfinite(line)] for line in lines])
    if not stacked.size:
        return np.nan, np.nan
    low, high = float(stacked.min()), float(stacked.max())
    span = (high - low) or abs(high) or 1.0
    estimate, spread = sources.column("estimate", quantity, dof), BAND * sources.column("std", quantity, dof)
    if np.isfinite(estimate + spread).all():
        low = max(min(low, float((estimate - spread).min())), low - span)
        high = min(max(high, float((estimate + spread).max())), high + span)
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def _draw_lines(axes: Axes, sources: _Sources, quantity: str, dof: int, factor: float) -> None:
    time = sources.time
    if sources.measures(quantity, dof):
        seen = sources.column("record", quantity, dof)
        every = -(-len(seen) // POINTS)
        axes.plot(time[::every], factor * seen[::every], **_LOOKS["observations"])
    for name in ("truth", "linear", "baseline"):
        line = sources.column(name, quantity, dof)
        if np.isfinite(line).all():
            kept = line_indices(line)
            axes.plot(time[kept], factor * line[kept], **_LOOKS[name])
    estimate, std = sources.column("estimate", quantity, dof), sources.column("std", quantity, dof)
    if np.isfinite(estimate).all():
        kept = line_indices(estimate)
        middle = factor * estimate[kept]
        if np.isfinite(std).all() and std.any():
            spread = factor * BAND * std[kept]
            axes.fill_between(time[kept], middle - spread, middle + spread, **_BAND_LOOK)
        # Dashes let the truth show through; alone, the estimate has nothing to let through.
        alone = {} if np.isfinite(sources.column("truth", quantity, dof)).all() else {"linestyle": "-"}
        axes.plot(time[kept], middle, **{**_LOOKS["estimate"], **alone})


_LOOKS: dict[str, dict[str, Any]] = {
    "observations": {**style.DOTS, "color": style.SKY, "zorder": 1.5},
    "truth": {"linestyle": "-", "linewidth": 1.0, "color": style.BLACK, "zorder": 2.0},
    "linear": {"linestyle": "-.", "linewidth": 0.6, "color": style.BLUE, "zorder": 1.8},
    "baseline": {"linestyle": (0, (1, 1)), "linewidth": 0.8, "color": style.GREEN, "zorder": 2.3},
    "estimate": {"linestyle": (0, (2.5, 1.2)), "linewidth": 0.8, "color": style.VERMILLION, "zorder": 2.2},
}
_BAND_LOOK: dict[str, Any] = {"color": style.VERMILLION, "alpha": 0.3, "linewidth": 0, "zorder": 1.9}


def _write_rms(axes: Axes, estimate: np.ndarray) -> None:
    """The size of an estimated force where there is none, which the common scale hides."""
    if np.isfinite(estimate).all():
        rms = float(np.sqrt(np.mean(estimate**2)))
        factor, prefix = style.unit_prefix(rms, kilo=True)
        decimals = 0 if factor * rms >= 10.0 else 1
        text = f"rms {factor * rms:.{decimals}f} {style.unit('force', prefix)}"
        axes.text(0.97, 0.93, text, transform=axes.transAxes, ha="right", va="top", fontsize=7)


def _shown(response: Response | None, dofs: list[int]) -> bool:
    """Whether any panel has such a line."""
    return response is not None and any(np.isfinite(getattr(response, name)[:, dofs]).any() for name in QUANTITIES)


def _legend(figure: Figure, sources: _Sources, dofs: list[int], names: dict[str, str]) -> None:
    titles = {"truth": names["truth"], "estimate": "estimate", "std": "95 % band"}
    titles |= {"linear": "equivalent linear system", "baseline": names["baseline"]}
    handles: list[Line2D | Patch] = [
        Patch(label=title, **_BAND_LOOK) if name == "std" else Line2D([], [], label=title, **_LOOKS[name])
        for name, title in titles.items()
        if _shown(getattr(sources, name), dofs)
    ]
    every = -(-len(sources.time) // POINTS)
    seen = "observations" + (f" (one in {every} shown)" if every > 1 else "")
    handles.append(Line2D([], [], label=seen, **{**_LOOKS["observations"], "markersize": 6}))
    room = {"handlelength": 2.2} if len(handles) < 6 else {"handlelength": 1.8, "columnspacing": 0.8}
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles), **room)
    notes = [] if sources.record.observed[dofs].all() else ["* no response sensor"]
    if len(sources.time) < len(sources.record.time):
        first, last = sources.record.time[[0, -1]]
        notes.append(f"middle of the record from {first:g} s to {last:g} s")
    figure.text(0.99, 0.002, "; ".join(notes), ha="right", va="bottom", fontsize=7)
