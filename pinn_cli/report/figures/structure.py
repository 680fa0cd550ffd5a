"""What was understood of a structure: its masses, the ground, and what joins them; and how it moves in a mode.

Masses stand in layers above the ground, by how many connections lead there, in an order in which few lines cross.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from html import escape

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.sparse import csr_matrix

from pinn_cli.report.estimates import ModeEstimates
from pinn_cli.report.figures import style
from pinn_cli.system.structure import Structure

MOST_IN_A_ROW = 6
_SWEEPS = 12  # over the layers, in which their orders settle
# Of a picture that moves: pixels from layer to layer, at most, the whole height, how far a mass moves, about a mass.
_LAYER_STEP, _HEIGHT, _REACH, _MARGIN = 46.0, 300.0, 22.0, 34.0
MOST_MOVING, MOST_MASSES = 6, 60  # modes, the lowest, and masses that can be told apart
_SLOWEST_S, _FASTEST_S = 3.0, 0.6  # a period on the screen: of the lowest mode, and of the highest at least
_ACROSS, _UP, _HIGHEST = 1.35, 0.95, 9.0  # inch, from mass to mass, from layer to layer, and of the figure
_FEW = 12  # of connections, up to which letters are large and weights are written down
# Where along its line the name of a connection may stand, the best place first; and how near to others it may not.
_PLACES = (0.5, 0.42, 0.58, 0.34, 0.66, 0.27, 0.73, 0.2, 0.8)
_ROOM = (0.5, 0.22)
_ABOVE = np.array([0.0, 0.13])  # the name of a dot stands there
_AROUND = [np.array((x, y)) for y in (0.0, 0.2, -0.2, 0.35, -0.35) for x in (0.0, 0.3, -0.3, 0.6, -0.6)]
_POINTS = np.linspace(0.0, 1.0, 41)[:, None]


def layout(matrix: csr_matrix) -> tuple[np.ndarray, bool]:
    """Places of the masses (n, 2), across and up, and whether a connection ends at the ground.

    Row i of the matrix (C, n) says which coordinates stretch connection i. Layers are one apart, and so are neighbours
    within one.
    """
    pattern = csr_matrix(abs(matrix) > 0, dtype=float)
    to_ground = np.asarray(pattern.sum(axis=1)).reshape(-1) == 1
    neighbours, distance = csr_matrix(pattern.T @ pattern), _distances(matrix, to_ground)
    layers = []
    for level in range(int(distance.max()) + 1):
        layer = np.flatnonzero(distance == level)
        layers += [part for part in np.array_split(layer, -(-len(layer) // MOST_IN_A_ROW)) if part.size]
    places = np.empty((matrix.shape[1], 2))
    for level, layer in enumerate(layers, start=1):
        places[layer] = np.column_stack((_centred(layer), np.full(len(layer), float(level))))
    for sweep in range(_SWEEPS):
        for layer in layers if sweep % 2 == 0 else layers[::-1]:
            wanted = [places[neighbours[dof].indices, 0].mean() for dof in layer]
            places[layer[np.argsort(wanted, kind="stable")], 0] = _centred(layer)
    return places, bool(to_ground.any())


def _centred(layer: np.ndarray) -> np.ndarray:
    return np.arange(len(layer)) - (len(layer) - 1) / 2.0


def _distances(matrix: csr_matrix, to_ground: np.ndarray) -> np.ndarray:
    """(n,), connections from each coordinate to the ground, by those that were written down first.

    A brace that comes after the storeys leaves them where they are. What no path leads to begins anew.
    """
    # Of a frame in the plane the ends at the ground are told by weights that do not cancel.
    ends = to_ground if to_ground.any() else np.abs(np.asarray(matrix.sum(axis=1)).reshape(-1)) > 1e-9
    rows = [matrix[i].indices for i in range(matrix.shape[0])]
    distance = np.full(matrix.shape[1], -1)
    while (distance < 0).any():
        placed = [(row, end or bool((distance[row] >= 0).any())) for row, end in zip(rows, ends, strict=True)]
        reached = next((row for row, leads_on in placed if leads_on and (distance[row] < 0).any()), None)
        if reached is None:
            distance[np.argmax(distance < 0)] = 0
            continue
        below = distance[reached][distance[reached] >= 0]
        distance[reached[distance[reached] < 0]] = below.min() + 1 if below.size else 0
    return distance


def moving_modes(structure: Structure, modes: ModeEstimates) -> Iterator[str]:
    """A picture (SVG) of every low mode that moves for ever; none of a structure without masses and connections.

    Every mass moves to the side by its displacement, whatever its direction is in the structure.
    """
    matrix = structure.incidence.matrix[structure.added]
    if structure.is_modal or not matrix.shape[0] or not 0 < matrix.shape[1] == len(modes.dofs) <= MOST_MASSES:
        return
    if not (abs(matrix).sum(axis=0) > 0).all():  # of a finite-element model the picture is not known
        return
    places, grounded = layout(csr_matrix(matrix))
    highest = places[:, 1].max()
    step = min(_LAYER_STEP, _HEIGHT / highest)
    x, y = (places[:, 0] - places[:, 0].min()) * 2.0 * _LAYER_STEP + _MARGIN, (highest - places[:, 1]) * step + _MARGIN
    width, base = x.max() + _MARGIN, y.max() + step
    lines = [(row.indices[0], row.indices[-1] if len(row.indices) > 1 else None) for row in matrix if row.nnz]
    frequencies = modes.table["frequency"].to_numpy()
    for mode, frequency in enumerate(frequencies[:MOST_MOVING]):
        reach = _REACH * modes.shapes["estimate"][:, mode]
        if not np.isfinite(reach).all():
            continue
        ratio = frequencies[0] / frequency if frequency > 0.0 else 1.0
        look = f'dur="{max(_SLOWEST_S * ratio, _FASTEST_S):.2f}s"'
        parts = [f'<path class="ground" d="M4 {base:.1f}H{width - 4:.1f}"/>'] if grounded else []
        for first, second in lines:
            ends = (x[first], y[first], reach[first])
            others = (x[first], base, 0.0) if second is None else (x[second], y[second], reach[second])
            both = "".join(_moving(f"x{i}", at, by, look) for i, (at, _, by) in enumerate((ends, others), start=1))
            parts.append(f'<line y1="{ends[1]:.1f}" y2="{others[1]:.1f}">{both}</line>')
        parts += [
            f'<circle cy="{below:.1f}" r="5"><title>{escape(name)}</title>{_moving("cx", at, by, look)}</circle>'
            for name, at, below, by in zip(modes.dofs, x, y, reach, strict=True)
        ]
        size = f'width="{width:.0f}" height="{base + 6:.0f}" viewBox="0 0 {width:.0f} {base + 6:.0f}"'
        yield f'<svg class="mode" role="img" aria-label="mode {mode + 1}" {size}>{"".join(parts)}</svg>'


def _moving(attribute: str, at: float, by: float, look: str) -> str:
    """To one side and the other, slowly at the ends."""
    values = ";".join(f"{at + side * by:.1f}" for side in (1, -1, 1))
    eased = 'calcMode="spline" keyTimes="0;.5;1" keySplines=".37 0 .63 1;.37 0 .63 1" repeatCount="indefinite"'
    return f'<animate attributeName="{attribute}" values="{values}" {look} {eased}/>'


@style.look()
def structure_figure(structure: Structure) -> Figure:
    """Masses in layers, by how many connections there are to the ground; a colour says the law of a connection.

    A connection between two coordinates, or to the ground, is a line. One that several coordinates stretch, or one by
    some part of its displacement, is a dot with a line to each, and where there are few connections their weights.
    """
    matrix = structure.incidence.matrix[structure.added]
    places, grounded = layout(matrix)
    laws = [law.name for law in structure.laws[: len(structure.added)]]  # what is behind them is damping of the whole
    colours = {law: style.CYCLE[i % len(style.CYCLE)] for i, law in enumerate(dict.fromkeys(laws))}
    few, lines = len(laws) <= _FEW, _lines(matrix, places)
    across = np.concatenate([places[:, 0], *(line[:, 0] for line in lines if line is not None)])
    width = float(np.clip(_ACROSS * (np.ptp(places[:, 0]) + 1.6), 3.4, style.PAGE_WIDTH))
    height = float(np.clip(_UP * (places[:, 1].max() + 1.0), 2.2, _HIGHEST))
    figure = Figure(figsize=(width, height))
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.98 - 0.26 / height))
    axes.set_axis_off()
    taken = [*places]
    for i, (name, law, line) in enumerate(zip(structure.labels.connections, laws, lines, strict=True)):
        look: style.Look = {"color": colours[law], "linewidth": 1.4 if few else 0.9, "zorder": 1}
        if line is None:
            place = _draw_hub(axes, matrix[i].data, places[matrix[i].indices], taken, look)
        else:
            axes.plot(*line.T, **look)
            place = _free_place([line[round(part * (len(line) - 1))] for part in _PLACES], taken)
        _write(axes, place, name, 8 if few else 5.5, colours[law])
    box = {"boxstyle": "round,pad=0.35", "facecolor": "#F2F2F2", "edgecolor": style.BLACK, "linewidth": 0.7}
    for dof, (x, y) in enumerate(places):
        mass = structure.parameter("m", dof).prescribed
        text = f"{structure.dof_name(dof)}\n" + ("mass unknown" if np.isnan(mass) else f"{mass:.6g} kg")
        axes.text(x, y, text, fontsize=8 if few else 6, ha="center", va="center", bbox=box, zorder=3)
    if grounded:
        feet = [*places[:, 0], *(line[0, 0] for line in lines if line is not None)]
        left, right = min(feet) - 0.5, max(feet) + 0.5
        axes.plot([left, right], [0.0, 0.0], color=style.BLACK, linewidth=1.2, zorder=2)
        x = np.arange(left, right, 0.15)
        axes.plot([x, x - 0.1], [0.0 * x, 0.0 * x - 0.12], color=style.BLACK, linewidth=0.6, zorder=2)
    axes.set_xlim(min(across.min() - 0.45, -1.0), max(across.max() + 0.45, 1.0))
    axes.set_ylim(-0.25, places[:, 1].max() + 0.45)
    handles = [Line2D([], [], color=c, linewidth=1.4, label=law.replace("_", " ")) for law, c in colours.items()]
    figure.legend(handles=handles, loc="upper center", ncols=min(len(handles), 5), bbox_to_anchor=(0.5, 1.0))
    return figure


def _lines(matrix: csr_matrix, places: np.ndarray) -> list[np.ndarray | None]:
    """(points, 2) of every connection that one end's displacement less the other's stretches; None of any other.

    A line that passes other layers or masses of its own bows out, right and left by turns, and so does the second one
    between two ends.
    """
    out: list[np.ndarray | None] = []
    bows, around = Counter[tuple[int, ...]](), 0
    for row in matrix:
        if sorted(row.data.tolist()) not in ([1.0], [-1.0], [-1.0, 1.0]):
            out.append(None)
            continue
        ends = tuple(np.sort(row.indices).tolist())
        end = places[ends[-1]]
        start = places[ends[0]] if len(ends) == 2 else np.array([end[0], 0.0])
        along, turn = end - start, bows[ends]
        bows[ends] += 1
        if abs(along[1]) > 1.5 or (along[1] == 0.0 and abs(along[0]) > 1.5):
            turn, around = turn + 1 + around % 2, around + 1
        length = float(np.hypot(*along))
        reach = 1.1 * (1 if turn % 2 else -1) * ((turn + 1) // 2) * max(1.0, 0.45 * length)
        if len(ends) == 1:
            start = start + np.array([0.45 * reach, 0.0])
        control = (start + end) / 2.0 + reach * np.array([along[1], -along[0]]) / max(length, 1e-9)
        out.append((1 - _POINTS) ** 2 * start + 2 * _POINTS * (1 - _POINTS) * control + _POINTS**2 * end)
    return out


def _draw_hub(
    axes: Axes, weights: np.ndarray, ends: np.ndarray, taken: list[np.ndarray], look: style.Look
) -> np.ndarray:
    """A dot between its ends with a line to each; the place of its name."""
    middle = ends.mean(axis=0) if len(ends) > 1 else ends[0] - np.array([0.0, 0.5])
    place = _free_place([middle + step + _ABOVE for step in _AROUND], taken)
    hub = place - _ABOVE
    axes.plot(*hub, "o", markersize=3, **{**look, "zorder": 2})
    for end, weight in zip(ends, weights, strict=True):
        axes.plot(*np.stack([hub, end]).T, **{**look, "linewidth": 0.6 * look["linewidth"]})
        if look["linewidth"] > 1.0:
            _write(axes, 0.55 * hub + 0.45 * end, f"{weight:.3g}", 6, style.GREY)
    return place


def _free_place(places: list[np.ndarray], taken: list[np.ndarray]) -> np.ndarray:
    """The first of those that are furthest from what is taken, which it joins; names are wider than high."""
    distances = [round(min(1.0, (np.abs(np.stack(taken) - place) / _ROOM).max(axis=1).min()), 1) for place in places]
    taken.append(places[int(np.argmax(distances))])
    return taken[-1]


def _write(axes: Axes, place: np.ndarray, text: str, size: float, colour: str) -> None:
    paper = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.text(place[0], place[1], text, fontsize=size, color=colour, ha="center", va="center", bbox=paper, zorder=2.5)
