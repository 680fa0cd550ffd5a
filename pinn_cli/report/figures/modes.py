"""Mode shapes of the estimated structure, one panel each, with their frequencies and damping ratios."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.report.modes import ModeEstimates

MOST_MODES, IN_A_ROW = 12, 4  # of more modes, the lowest
MOST_DOF_LABELS = 16

_TRUE: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.0, "zorder": 2.0}
_PRESCRIBED: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.9, "linestyle": (0, (1, 1.2)), "zorder": 2.1}
_ESTIMATE: dict[str, Any] = {
    "color": style.VERMILLION, "linewidth": 0.9, "linestyle": (0, (2.5, 1.2)), "marker": "o", "markersize": 3.0,
    "zorder": 2.2,
}  # fmt: skip


def modes_figure(modes: ModeEstimates, truth_label: str = "truth") -> Figure:
    """A panel per mode: its shape over the DOFs; above it frequency and damping ratio with their 90 % intervals.

    Of a chain the shape begins at the fixed end, and DOF 1 is the lowest. The DOFs of another structure stand in their
    own order, as points.

    Args:
        modes: Of the estimate; of more than `MOST_MODES` the lowest are drawn.
        truth_label: What the legend calls the modes of the structure that a simulated record comes from.
    """
    shown = min(modes.count, MOST_MODES)
    columns = min(shown, IN_A_ROW)
    rows = -(-shown // columns)
    height = float(np.clip(0.16 * len(modes.dofs), 1.3, 2.6))
    width = style.PAGE_WIDTH if columns > 2 else 2.6 + 1.3 * columns
    with style.look():
        figure, panels = style.panels(
            rows, columns, height, width=width, margins=(_left(modes), 0.1, 0.72, 0.32), gaps=(0.16, 0.74), sharey=True
        )
        for mode, axes in enumerate(panels.reshape(-1)):
            if mode < shown:
                _draw_shape(axes, modes, mode)
            else:
                axes.set_axis_off()
        _name_dofs(panels[:, 0], modes)
        _legend(figure, modes, truth_label)
        if shown < modes.count:
            note = f"the {shown} lowest of {modes.count} modes"
            figure.text(0.01, 0.004, note, ha="left", va="bottom", fontsize=7)
    return figure


def _left(modes: ModeEstimates) -> float:
    """Room for the names of the DOFs, inch."""
    return 0.42 + 0.055 * min(max(len(name) for name in modes.dofs), 16)


def _draw_shape(axes: Axes, modes: ModeEstimates, mode: int) -> None:
    kinds = ((modes.true.shapes, _TRUE), (modes.prescribed.shapes, _PRESCRIBED), (modes.shapes, _ESTIMATE))
    place = np.arange(1, len(modes.dofs) + 1)
    axes.axvline(0.0, color="#BFBFBF", linewidth=0.5, zorder=1.0)
    for shapes, look in kinds:
        shape = shapes[:, mode]
        if not np.isfinite(shape).all():
            continue
        if modes.is_chain:
            axes.plot([0.0, *shape], [0, *place], **look, markevery=slice(1, None))
        else:
            axes.plot(shape, place, **_as_points(look))
            if look is _ESTIMATE:
                axes.hlines(place, 0.0, shape, color=style.VERMILLION, linewidth=0.6)
    axes.set_xlim(-1.15, 1.15)
    axes.set_ylim((0.0 if modes.is_chain else 0.4), len(modes.dofs) + 0.4)
    axes.xaxis.set_major_locator(FixedLocator([-1, 0, 1]))
    axes.set_title(_title(modes, mode), pad=3, fontsize=7, linespacing=1.15)


def _as_points(look: dict[str, Any]) -> dict[str, Any]:
    return {"marker": "|", "markersize": 9.0, **look, "linestyle": "none"}


def _title(modes: ModeEstimates, mode: int) -> str:
    frequency = interval_text(modes.frequencies[mode], modes.frequency_interval[:, mode], "Hz")
    damping = interval_text(100.0 * modes.damping_ratios[mode], 100.0 * modes.damping_interval[:, mode], "%")
    mac = modes.prescribed.mac[mode]
    lines = [f"mode {mode + 1}: {frequency}", rf"$\zeta$ = {damping}"]
    return "\n".join([*lines, f"MAC {mac:.4f}"] if np.isfinite(mac) else lines)


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


def _name_dofs(left: np.ndarray, modes: ModeEstimates) -> None:
    every = -(-len(modes.dofs) // MOST_DOF_LABELS)
    places = range(1, len(modes.dofs) + 1, every)
    for axes in left:
        axes.set_yticks(list(places), [modes.dofs[i - 1] for i in places])
        axes.set_ylabel("DOF", labelpad=2)


def _legend(figure: Figure, modes: ModeEstimates, truth_label: str) -> None:
    kinds = (
        (modes.true.shapes, truth_label, _TRUE),
        (modes.prescribed.shapes, "prescribed", _PRESCRIBED),
        (modes.shapes, "estimate (90 % intervals)", _ESTIMATE),
    )
    handles = [
        Line2D([], [], label=label, **(look if modes.is_chain else _as_points(look)))
        for shapes, label, look in kinds
        if np.isfinite(shapes).any()
    ]
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
