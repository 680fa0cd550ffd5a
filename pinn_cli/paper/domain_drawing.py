"""Figure 3: where there are data and where physics is enforced, scheme by scheme."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from pinn_cli.report.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NDOF, _SAMPLES = 6, 13


@dataclass(frozen=True)
class _Domains:
    """DOFs with sensors, and whether only the start is known, of one scheme."""

    title: str
    observed: tuple[int, ...]
    start_only: bool = False


_SCHEMES = (
    _Domains("(a) forward solution", tuple(range(1, _NDOF + 1)), start_only=True),
    _Domains("(b) sparse recovery", (1, 2)),
    _Domains("(c) state-parameter estimation", (1, 3, 5, 6)),
    _Domains("(d) Bayesian parameter estimation", tuple(range(1, _NDOF + 1))),
)
_POINT: dict[str, Any] = {
    "linestyle": "none",
    "marker": "o",
    "markersize": 3.2,
    "markeredgewidth": 0,
    "color": style.VERMILLION,
}
_AREA: dict[str, Any] = {"facecolor": style.SKY, "alpha": 0.35, "linewidth": 0}


def domain_figure() -> Figure:
    """Two by two panels over time and DOF: the collocation domain shaded, observations as points."""
    with style.look():
        figure = Figure(figsize=(0.8 * style.PAGE_WIDTH, 3.5))
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        for axes, scheme in zip(panels.flat, _SCHEMES, strict=True):
            _draw_panel(axes, scheme)
        for axes in panels[1]:
            axes.set_xlabel(r"Time $t$")
        for axes in panels[:, 0]:
            axes.set_ylabel("DOF")
        handles = [
            Patch(label=r"collocation domain $\Omega_p$: physics", **_AREA),
            Line2D([], [], label=r"observation domain $\Omega_o$: data", **_POINT),
        ]
        figure.legend(handles=handles, loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.0))
        figure.subplots_adjust(left=0.08, right=0.98, top=0.86, bottom=0.1, wspace=0.1, hspace=0.28)
    return figure


def _draw_panel(axes: Axes, scheme: _Domains) -> None:
    axes.add_patch(Rectangle((0.0, 0.5), 1.0, _NDOF, **_AREA))
    times = np.array([0.0]) if scheme.start_only else np.linspace(0.0, 1.0, _SAMPLES)
    for dof in scheme.observed:
        axes.plot(times, np.full(len(times), dof), **_POINT, clip_on=False)
    axes.set(xlim=(-0.03, 1.03), ylim=(_NDOF + 0.7, 0.3), xticks=[0.0, 1.0], yticks=range(1, _NDOF + 1))
    axes.set_xticklabels(["0", "$T$"])
    axes.set_yticklabels(["1", "2", *[""] * (_NDOF - 3), "$n$"])
    axes.set_title(scheme.title, loc="left")
