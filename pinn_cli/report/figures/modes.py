"""Mode shapes of the estimated structure, one panel each, with their frequencies and damping ratios."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from pinn_cli.report.figures import style
from pinn_cli.report.modes import ModeEstimates

MOST_MODES, IN_A_ROW = 12, 4  # of more modes, the lowest
MOST_DOF_LABELS = 16

_TRUE: style.Look = {"color": style.BLACK, "linewidth": 1.0, "zorder": 2.0}
_PRESCRIBED: style.Look = {"color": style.BLUE, "linewidth": 0.9, "linestyle": (0, (1, 1.2)), "zorder": 2.1}
_ESTIMATE: style.Look = {
    "color": style.VERMILLION, "linewidth": 0.9, "linestyle": (0, (2.5, 1.2)), "marker": "o", "markersize": 3.0,
    "zorder": 2.2,
}  # fmt: skip


def modes_figure(modes: ModeEstimates, truth_label: str = "truth") -> Figure:
    """A panel per mode: its shape over the DOFs; above it frequency and damping ratio with their 90 % intervals.

    Of a chain the shape begins at the fixed end, and DOF 1 is the lowest. The DOFs of another structure stand in their
    own order, as points. Of more than `MOST_MODES` modes the lowest are drawn.
    """
    dofs, shown = modes.dofs, min(modes.count, MOST_MODES)
    columns = min(shown, IN_A_ROW)
    width = style.PAGE_WIDTH if columns > 2 else 2.6 + 1.3 * columns
    left = 0.42 + 0.055 * min(max(map(len, dofs)), 16)  # inch, with room for the names of the DOFs
    with style.look():
        figure, panels = style.panels(
            -(-shown // columns), columns, float(np.clip(0.16 * len(dofs), 1.3, 2.6)), width=width,
            margins=(left, 0.1, 0.72, 0.32), gaps=(0.16, 0.74), sharey=True,
        )  # fmt: skip
        for mode, axes in enumerate(panels.flat):
            if mode < shown:
                _draw_shape(axes, modes, mode, truth_label)
            else:
                axes.set_axis_off()
        places = range(1, len(dofs) + 1, -(-len(dofs) // MOST_DOF_LABELS))
        for axes in panels[:, 0]:
            axes.set_yticks(list(places), [dofs[i - 1] for i in places])
            axes.set_ylabel("DOF", labelpad=2)
        style.legend(figure)
        if shown < modes.count:
            style.note(figure, f"the {shown} lowest of {modes.count} modes")
    return figure


def _draw_shape(axes: Axes, modes: ModeEstimates, mode: int, truth_label: str) -> None:
    kinds = (
        (modes.true.shapes, truth_label, _TRUE),
        (modes.prescribed.shapes, "prescribed", _PRESCRIBED),
        (modes.shapes, "estimate (90 % intervals)", _ESTIMATE),
    )
    place = np.arange(1, len(modes.dofs) + 1)
    axes.axvline(0.0, color="#BFBFBF", linewidth=0.5, zorder=1.0)
    for shapes, label, look in kinds:
        shape = shapes[:, mode]
        if not np.isfinite(shape).all():
            continue
        if modes.is_chain:
            axes.plot([0.0, *shape], [0, *place], **look, label=label, markevery=slice(1, None))
        else:
            points = {"marker": "|", "markersize": 9.0, **look, "linestyle": "none"}
            axes.plot(shape, place, **points, label=label)
            if look is _ESTIMATE:
                axes.hlines(place, 0.0, shape, color=style.VERMILLION, linewidth=0.6)
    axes.set_xlim(-1.15, 1.15)
    axes.set_ylim((0.0 if modes.is_chain else 0.4), len(modes.dofs) + 0.4)
    axes.xaxis.set_major_locator(FixedLocator([-1, 0, 1]))
    frequency = interval_text(modes.frequencies[mode], modes.frequency_interval[:, mode], "Hz")
    damping = interval_text(100.0 * modes.damping_ratios[mode], 100.0 * modes.damping_interval[:, mode], "%")
    mac = modes.prescribed.mac[mode]
    known = f"\nMAC {mac:.4f}" if np.isfinite(mac) else ""
    title = f"mode {mode + 1}: {frequency}\n" + rf"$\zeta$ = {damping}" + known
    axes.set_title(title, pad=3, fontsize=7, linespacing=1.15)


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
