"""Figure 1: the chain of masses, drawn as structural dynamics draws it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH, _HEIGHT = style.PAGE_WIDTH, 2.05  # inch
_MASS, _LINK = 0.78, 1.18  # widths of a mass and of a connection, in the drawing's own unit
_TOP, _BOTTOM = 1.0, -0.62  # of a mass
_HEIGHTS = (0.72, 0.19, -0.34)  # of damper, spring and nonlinear element


def chain_figure() -> Figure:
    """Fixed end, masses 1, 2 and n, three parallel elements in each connection, forces and displacements."""
    with style.look():
        figure = Figure(figsize=(_WIDTH, _HEIGHT))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_aspect("equal")
        axes.set_axis_off()
        _draw_wall(axes)
        left = 0.0
        for name, broken in (("1", False), ("2", False), ("n", True)):
            left = _draw_gap(axes, left) if broken else left
            _draw_connection(axes, left, left + _LINK, name)
            _draw_mass(axes, left + _LINK, name)
            left += _LINK + _MASS
        axes.set_xlim(-0.3, left + 0.3)
        axes.set_ylim(-1.0, 1.78)
    return figure


def _draw_wall(axes: Axes) -> None:
    axes.plot([0, 0], [_BOTTOM - 0.12, _TOP + 0.12], color=style.BLACK, linewidth=1.4)
    for height in np.arange(_BOTTOM - 0.02, _TOP + 0.16, 0.13):
        axes.plot([-0.13, 0], [height - 0.11, height], color=style.BLACK, linewidth=0.6)


def _draw_mass(axes: Axes, left: float, name: str) -> None:
    axes.add_patch(
        Rectangle((left, _BOTTOM), _MASS, _TOP - _BOTTOM, facecolor="#DCE8F2", edgecolor=style.BLACK, linewidth=0.9)
    )
    middle = left + _MASS / 2.0
    axes.text(middle, (_TOP + _BOTTOM) / 2.0, f"$m_{name}$", ha="center", va="center", fontsize=12)
    # The displacement is counted from a mark on the mass, the force pushes it.
    axes.plot([middle, middle], [_TOP, _TOP + 0.22], color=style.BLACK, linewidth=0.7)
    _arrow(axes, (middle, _TOP + 0.18), (middle + 0.42, _TOP + 0.18), style.BLACK)
    axes.text(middle + 0.47, _TOP + 0.18, f"$u_{name}$", va="center", fontsize=10)
    _arrow(axes, (middle - 0.2, _TOP + 0.5), (middle + 0.42, _TOP + 0.5), style.VERMILLION)
    axes.text(middle + 0.47, _TOP + 0.5, f"$f_{name}$", va="center", fontsize=10, color=style.VERMILLION)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    look = {"arrowstyle": "-|>", "color": colour, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=end, xytext=start, arrowprops=look)


def _draw_connection(axes: Axes, left: float, right: float, name: str) -> None:
    damper, spring, nonlinear = _HEIGHTS
    _draw_damper(axes, left, right, damper)
    _draw_spring(axes, left, right, spring)
    _draw_spring(axes, left, right, nonlinear)
    middle = (left + right) / 2.0
    _arrow(axes, (middle - 0.24, nonlinear - 0.2), (middle + 0.26, nonlinear + 0.2), style.BLUE)
    for height, text in ((damper + 0.24, f"$c_{name}$"), (spring + 0.2, f"$k_{name}$")):
        axes.text(middle, height, text, ha="center", va="center", fontsize=10)
    label = rf"$\kappa_{name}$ or $\mu_{name}$"
    axes.text(middle, nonlinear - 0.32, label, ha="center", va="center", fontsize=10, color=style.BLUE)


def _draw_spring(axes: Axes, left: float, right: float, height: float) -> None:
    ends = 0.22 * (right - left)
    inner = np.linspace(left + ends, right - ends, 14)
    zigzag = height + 0.09 * np.array([0, *([1, -1] * 6), 0])
    axes.plot([left, *inner, right], [height, *zigzag, height], color=style.BLACK, linewidth=0.8)


def _draw_damper(axes: Axes, left: float, right: float, height: float) -> None:
    middle = (left + right) / 2.0
    line: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.8}
    axes.plot([left, middle - 0.15], [height, height], **line)
    axes.plot([middle + 0.15, middle - 0.15, middle - 0.15, middle + 0.15],
              [height + 0.1, height + 0.1, height - 0.1, height - 0.1], **line)  # fmt: skip
    axes.plot([middle, right], [height, height], **line)
    axes.plot([middle, middle], [height - 0.07, height + 0.07], **{**line, "linewidth": 1.4})


def _draw_gap(axes: Axes, left: float) -> float:
    """Dots for the masses between; where the next connection begins."""
    axes.text(left + 0.28, (_TOP + _BOTTOM) / 2.0, r"$\cdots$", ha="center", va="center", fontsize=16)
    return left + 0.56
