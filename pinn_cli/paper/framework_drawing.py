"""Figure 2: what a physics-informed neural network is made of, and what pulls on it."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH, _HEIGHT = style.PAGE_WIDTH, 3.3  # inch; the drawing's unit is the inch too
_DATA, _PHYSICS, _NEUTRAL = "#FBE3D6", "#DCE8F2", "#F2F2F2"
_LAYERS = ((0.42, 1), (1.0, 4), (1.5, 4), (2.08, 2))  # abscissa and number of units
_MIDDLE = 2.3  # height of the network's axis


def framework_figure() -> Figure:
    """Time through a network to the state; data and physics as two losses; one optimiser of weights and parameters."""
    with style.look():
        figure = Figure(figsize=(_WIDTH, _HEIGHT))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0, _WIDTH), ylim=(0, _HEIGHT))
        axes.set_axis_off()
        _draw_network(axes)
        _box(
            axes,
            (2.55, 1.95),
            (1.12, 0.7),
            "state and its\nderivatives\n" + r"$u,\ \dot{u},\ \ddot{u}$ at any $t$",
            _NEUTRAL,
        )
        _draw_losses(axes)
        _draw_training(axes)
    return figure


def _draw_network(axes: Axes) -> None:
    places = [[(x, _MIDDLE + 0.34 * (i - (count - 1) / 2.0)) for i in range(count)] for x, count in _LAYERS]
    for left, right in pairwise(places):
        for x, y in left:
            for end in right:
                axes.plot([x, end[0]], [y, end[1]], color=style.GREY, linewidth=0.4, zorder=1)
    for layer, unit in enumerate(places):
        for x, y in unit:
            inner = layer in (1, 2)
            face = "white" if inner else _NEUTRAL
            axes.add_patch(Circle((x, y), 0.12, facecolor=face, edgecolor=style.BLACK, linewidth=0.8, zorder=2))
    for place, text in ((places[0][0], r"$t$"), (places[3][1], r"$u$"), (places[3][0], r"$\dot{u}$")):
        axes.text(*place, text, ha="center", va="center", fontsize=8, zorder=3)
    axes.text(1.25, 3.12, r"network $\mathcal{N}(t;\,\theta_n)$", ha="center", va="center", fontsize=9)
    _arrow(axes, (2.23, _MIDDLE), (2.55, _MIDDLE))


def _draw_losses(axes: Axes) -> None:
    _box(
        axes,
        (4.05, 2.42),
        (1.4, 0.66),
        "observation domain $\\Omega_o$\n" + r"measured $\ddot{u}^{*}$ at the sensors",
        _DATA,
    )
    _box(
        axes,
        (4.05, 1.42),
        (1.4, 0.74),
        "collocation domain $\\Omega_p$\nequation of motion,\n" + r"parameters $\theta_s$",
        _PHYSICS,
    )
    _box(axes, (5.75, 2.42), (1.3, 0.66), "data\n" + r"$L_o=\langle \ddot{u}^{*}-\tilde{\ddot{u}}\rangle$", _DATA)
    _box(
        axes,
        (5.75, 1.42),
        (1.3, 0.74),
        "physics\n"
        r"$L_p=\langle f^{*}-\tilde{f}\,\rangle$"
        "\n"
        r"$L_c=\langle \dot{u}-\mathrm{d}u/\mathrm{d}t\rangle$",
        _PHYSICS,
    )
    for height in (2.75, 1.79):
        _arrow(axes, (3.67, _MIDDLE), (4.05, height))
        _arrow(axes, (5.45, height), (5.75, height))
    axes.text(6.4, 2.29, "+", ha="center", va="center", fontsize=11)


def _draw_training(axes: Axes) -> None:
    loss = r"$L=\lambda_o L_o+\lambda_c L_c+\lambda_p L_p$" + "\n" + r"weights $\lambda=1/\sigma^2$: noise levels"
    _box(axes, (4.75, 0.38), (2.3, 0.62), loss, _NEUTRAL)
    _box(
        axes,
        (1.6, 0.38),
        (2.5, 0.62),
        "training: Gauss-Newton or Adam\n" + r"moves $\theta_n$, $\theta_s$ until $L$ is small",
        _NEUTRAL,
    )
    _arrow(axes, (6.4, 1.42), (6.4, 1.0))
    _arrow(axes, (4.75, 0.69), (4.1, 0.69))
    _arrow(axes, (1.9, 1.0), (1.5, 1.62))
    _arrow(axes, (3.75, 1.0), (4.3, 1.42))
    axes.text(1.78, 1.36, r"$\theta_n$", fontsize=9)
    axes.text(3.85, 1.26, r"$\theta_s$", ha="right", fontsize=9)


def _box(axes: Axes, corner: tuple[float, float], size: tuple[float, float], text: str, colour: str) -> None:
    axes.add_patch(
        FancyBboxPatch(
            corner, *size, boxstyle="round,pad=0,rounding_size=0.06", facecolor=colour, edgecolor=style.BLACK,
            linewidth=0.8, zorder=2,
        )
    )  # fmt: skip
    middle = (corner[0] + size[0] / 2.0, corner[1] + size[1] / 2.0)
    axes.text(*middle, text, ha="center", va="center", fontsize=8, linespacing=1.4, zorder=3)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    look = {"arrowstyle": "-|>", "color": style.BLACK, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=end, xytext=start, arrowprops=look, zorder=1)
