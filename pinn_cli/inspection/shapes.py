"""Shapes of modes at the sensors, with their intervals, and what each of several records says of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.record.identification.modes import NORMAL_90
from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.inspection.joined import JoinedMode
    from pinn_cli.inspection.modes import ModesAtSensors

MODES, ACROSS, NAMES = 12, 3, 14  # of them are drawn, panels in a row, names of sensors below a panel
LONGEST = 8  # letters of a name

_SHAPE: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.8, "marker": "o", "markersize": 3.0, "capsize": 1.5,
                          "elinewidth": 0.6, "zorder": 2, "label": "shape and its 90 % interval"}  # fmt: skip
_ZERO: dict[str, Any] = {"color": style.GREY, "linewidth": 0.5, "zorder": 0}
_MARKS = ("x", "+", "1", "2", "3", "4")
_COLOURS = (style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE, style.BLACK, style.SKY)


def shapes_figure(found: ModesAtSensors, joined: Sequence[JoinedMode] = ()) -> Figure:
    """A panel for each mode.

    Args:
        found: The modes.
        joined: The same, where they are of several records: every record's own shape is drawn as points.
    """
    shown = min(len(found.modes), MODES)
    rows, across = -(-shown // ACROSS), min(shown, ACROSS)
    with style.look():
        figure, panels = style.panels(
            rows, across, 1.25, margins=(0.42, 0.1, 0.46, 0.46), gaps=(0.34, 0.5), sharey=True
        )
        for number, axes in enumerate(panels.flat):
            if number >= shown:
                axes.set_axis_off()
                continue
            _draw(axes, found, number)
            for part in joined[number].parts if joined else ():
                _draw_part(axes, joined[number], part.record)
        for axes in panels[:, 0]:
            axes.set_ylabel("displacement")
        style.legend(figure, handlelength=1.4, columnspacing=1.2)
        if len(found.modes) > MODES:
            style.note(figure, f"{len(found.modes) - MODES} further modes are left to modes.csv")
    return figure


def _draw(axes: Axes, found: ModesAtSensors, number: int) -> None:
    shape, std = found.shapes[number].real, found.shape_std(number)
    at = np.flatnonzero(np.isfinite(shape))
    axes.axhline(0.0, **_ZERO)
    axes.errorbar(at, shape[at], NORMAL_90 * std[at], **_SHAPE)
    axes.set_title(f"{found.modes[number].frequency:.4g} Hz", loc="left", pad=3)
    every = -(-len(shape) // NAMES)
    places = range(0, len(shape), every)
    axes.set_xticks(places, [style.literal(found.names[i][:LONGEST]) for i in places])
    if max(len(name) for name in found.names) > 2:
        axes.tick_params(axis="x", rotation=90)
    axes.set_xlim(-0.5, len(shape) - 0.5)
    axes.set_ylim(-1.4, 1.4)


def _draw_part(axes: Axes, mode: JoinedMode, record: int) -> None:
    """A record's own shape, as large as the joined one."""
    i = next(i for i, part in enumerate(mode.parts) if part.record == record)
    part, look = mode.parts[i], record % len(_MARKS)
    shape = (part.shape / mode.scales[i]).real
    axes.plot(part.places, shape, linestyle="none", marker=_MARKS[look], color=_COLOURS[look], markersize=4.0,
              zorder=3, label=f"record {record + 1}")  # fmt: skip
