"""What was understood of a structure that a user wrote down: its masses, the ground, and what joins them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pinn_cli.report.figures import style
from pinn_cli.report.figures.layers import GROUND_LEVEL, Layout, layout_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pinn_cli.system.structure import Structure

_ACROSS, _UP = 1.35, 0.95  # inch, from mass to mass and from layer to layer, where there is room
_HIGHEST = 9.0  # inch, of the figure
_FEW = 12  # of connections, up to which letters are large and weights are written down
# Where along its line the name of a connection may stand, the best place first; and how near to others it may not.
_PLACES = (0.5, 0.42, 0.58, 0.34, 0.66, 0.27, 0.73, 0.2, 0.8)
_ROOM = (0.5, 0.22)
_ABOVE = np.array([0.0, 0.13])  # the name of a dot stands there
_POINTS = np.linspace(0.0, 1.0, 41)[:, None]


@dataclass(frozen=True, eq=False)
class _Connection:
    """One connection: its name and law, the coordinates that stretch it (from 0), and their weights."""

    name: str
    law: str
    coordinates: np.ndarray
    weights: np.ndarray


def structure_figure(structure: Structure) -> Figure:
    """Masses in layers, by how many connections there are to the ground; a colour says the law of a connection.

    A connection between two coordinates, or to the ground, is a line. One that several coordinates stretch, or one by
    some part of its displacement, is a dot with a line to each.

    Args:
        structure: With names.
    """
    connections = _connections(structure)
    layout = layout_of(structure.incidence.matrix[structure.added])
    laws = list(dict.fromkeys(connection.law for connection in connections))
    colours = {law: style.CYCLE[i % len(style.CYCLE)] for i, law in enumerate(laws)}
    few = len(connections) <= _FEW
    with style.look():
        width = float(np.clip(_ACROSS * (layout.width + 1.6), 3.4, style.PAGE_WIDTH))
        height = float(np.clip(_UP * (layout.height + 1.0), 2.2, _HIGHEST))
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((0.01, 0.01, 0.98, 0.98 - 0.26 / height))
        axes.set_axis_off()
        taken = [*layout.places]
        lines = _lines(connections, layout)
        for connection, line in zip(connections, lines, strict=True):
            _draw_connection(axes, connection, line, layout, colours[connection.law], taken, few)
        _draw_masses(axes, structure, layout, few)
        _draw_ground(axes, layout, [line[0, 0] for line in lines if line is not None])
        across = np.concatenate([layout.places[:, 0], *(line[:, 0] for line in lines if line is not None)])
        axes.set_xlim(min(across.min() - 0.45, -1.0), max(across.max() + 0.45, 1.0))
        axes.set_ylim(GROUND_LEVEL - 0.25, layout.places[:, 1].max() + 0.45)
        handles = [Line2D([], [], color=colours[law], linewidth=1.4, label=law.replace("_", " ")) for law in laws]
        figure.legend(handles=handles, loc="upper center", ncols=min(len(laws), 5), bbox_to_anchor=(0.5, 1.0))
    return figure


def _connections(structure: Structure) -> list[_Connection]:
    matrix = structure.incidence.matrix
    laws = [group.nonlinearity.name for group in structure.groups for _ in range(group.incidence.shape[0])]
    laws = laws[: len(structure.added)]  # what is behind them is damping of the whole
    rows = [matrix[i] for i in structure.added]
    return [
        _Connection(name, law, row.indices, row.data)
        for name, law, row in zip(structure.labels.connections, laws, rows, strict=True)
    ]


def _lines(connections: list[_Connection], layout: Layout) -> list[np.ndarray | None]:
    """(points, 2) of every connection between two ends; None of one that has other weights, or more ends.

    A line that would run through masses between its ends bows out, and so does the second one between two ends.
    """
    out: list[np.ndarray | None] = []
    bows: dict[tuple[int, ...], int] = {}
    around = 0
    for connection in connections:
        if not _is_plain(connection):
            out.append(None)
            continue
        key = tuple(sorted(connection.coordinates.tolist()))
        end = layout.places[key[-1]]
        start = layout.places[key[0]] if len(key) == 2 else np.array([end[0], GROUND_LEVEL])
        between = np.abs(start[1] - end[1]) > 1.5 or (start[1] == end[1] and np.abs(start[0] - end[0]) > 1.5)
        turn = bows.get(key, 0)
        bows[key] = turn + 1
        if between and layout.blocked(start, end):
            turn, around = turn + 1 + around % 2, around + 1
        out.append(_bowed(start, end, turn, on_ground=len(key) == 1))
    return out


def _is_plain(connection: _Connection) -> bool:
    """Whether one end's displacement less the other's stretches it."""
    weights = np.sort(connection.weights)
    return bool((len(weights) == 1 and abs(weights[0]) == 1.0) or weights.tolist() == [-1.0, 1.0])


def _bowed(start: np.ndarray, end: np.ndarray, turn: int, on_ground: bool) -> np.ndarray:
    """(points, 2): a straight line, or the arc of the turn-th line between two ends, right and left by turns."""
    side = (1 if turn % 2 else -1) * ((turn + 1) // 2)
    along = end - start
    across = np.array([along[1], -along[0]]) / max(float(np.hypot(*along)), 1e-9)
    reach = 1.1 * side * max(1.0, 0.45 * float(np.hypot(*along)))
    if on_ground:
        start = start + np.array([0.45 * reach, 0.0])
    control = (start + end) / 2.0 + across * reach
    points: np.ndarray = (1 - _POINTS) ** 2 * start + 2 * _POINTS * (1 - _POINTS) * control + _POINTS**2 * end
    return points


def _draw_connection(
    axes: Axes, connection: _Connection, line: np.ndarray | None, layout: Layout, colour: str,
    taken: list[np.ndarray], few: bool,
) -> None:  # fmt: skip
    look: dict[str, Any] = {"color": colour, "linewidth": 1.4 if few else 0.9, "zorder": 1}
    if line is not None:
        axes.plot(*line.T, **look)
        places = [line[round(part * (len(line) - 1))] for part in _PLACES]
    else:
        ends = layout.places[connection.coordinates]
        middle = ends.mean(axis=0) if len(ends) > 1 else ends[0] - np.array([0.0, 0.5])
        places = [
            middle + np.array([x, y]) + _ABOVE
            for y in (0.0, 0.2, -0.2, 0.35, -0.35)
            for x in (0.0, 0.3, -0.3, 0.6, -0.6)
        ]
    place = max(places, key=lambda p: round(_distance(p, taken), 1))
    taken.append(place)
    if line is None:
        hub = place - _ABOVE
        axes.plot(*hub, "o", markersize=3, **{**look, "zorder": 2})
        for end, weight in zip(layout.places[connection.coordinates], connection.weights, strict=True):
            axes.plot(*np.stack([hub, end]).T, **{**look, "linewidth": 0.6 * look["linewidth"]})
            if few:
                _write(axes, 0.55 * hub + 0.45 * end, f"{weight:.3g}", 6, style.GREY)
    _write(axes, place, connection.name, 8 if few else 5.5, colour)


def _distance(place: np.ndarray, taken: list[np.ndarray]) -> float:
    """To the nearest of those that are taken, names being wider than high; beyond one all are as good."""
    if not taken:
        return 1.0
    apart = np.abs(np.stack(taken) - place) / _ROOM
    return float(min(1.0, apart.max(axis=1).min()))


def _write(axes: Axes, place: np.ndarray, text: str, size: float, colour: str) -> None:
    paper = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.text(place[0], place[1], text, fontsize=size, color=colour, ha="center", va="center", bbox=paper, zorder=2.5)


def _draw_masses(axes: Axes, structure: Structure, layout: Layout, few: bool) -> None:
    box = {"boxstyle": "round,pad=0.35", "facecolor": "#F2F2F2", "edgecolor": style.BLACK, "linewidth": 0.7}
    for dof, place in enumerate(layout.places):
        mass = structure.parameter("m", dof).prescribed
        weight = "mass unknown" if np.isnan(mass) else f"{mass:.6g} kg"
        text, size = f"{structure.dof_name(dof)}\n{weight}", 8 if few else 6
        axes.text(place[0], place[1], text, fontsize=size, ha="center", va="center", bbox=box, zorder=3)


def _draw_ground(axes: Axes, layout: Layout, feet: list[float]) -> None:
    if not layout.grounded:
        return
    across = [*layout.places[:, 0], *feet]
    left, right = min(across) - 0.5, max(across) + 0.5
    axes.plot([left, right], [GROUND_LEVEL, GROUND_LEVEL], color=style.BLACK, linewidth=1.2, zorder=2)
    for x in np.arange(left, right, 0.15):
        axes.plot([x, x - 0.1], [GROUND_LEVEL, GROUND_LEVEL - 0.12], color=style.BLACK, linewidth=0.6, zorder=2)
