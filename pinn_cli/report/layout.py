"""Where the masses of a structure are drawn, and how they move in a mode.

Masses stand in layers above the ground, by how many connections lead there, in an order in which few lines cross.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np
from scipy.sparse import csr_matrix

from pinn_cli.report.estimates import ModeEstimates
from pinn_cli.system.structure import Structure

MOST_IN_A_ROW = 6
_SWEEPS = 12  # over the layers, in which their orders settle
# Of a picture that moves: pixels from layer to layer, at most, the whole height, how far a mass moves, about a mass.
_LAYER_STEP, _HEIGHT, _REACH, _MARGIN = 46.0, 300.0, 22.0, 34.0
MOST_MOVING, MOST_MASSES = 6, 60  # modes, the lowest, and masses that can be told apart
_SLOWEST_S, _FASTEST_S = 3.0, 0.6  # a period on the screen: of the lowest mode, and of the highest at least


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
    for mode in range(min(modes.count, MOST_MOVING)):
        reach = _REACH * modes.shapes[:, mode]
        if not np.isfinite(reach).all():
            continue
        ratio = modes.frequencies[0] / modes.frequencies[mode] if modes.frequencies[mode] > 0.0 else 1.0
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
