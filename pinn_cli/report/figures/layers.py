"""Where the masses of a structure stand in a drawing: in layers above the ground, neighbours below each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

GROUND_LEVEL = 0.0
MOST_IN_A_ROW = 6
_SWEEPS = 12


@dataclass(frozen=True, eq=False)
class Layout:
    """Places of the masses.

    Attributes:
        places: (n, 2), across and up; layers are one apart, and so are neighbours within one.
        grounded: Whether a connection ends at the ground.
    """

    places: np.ndarray
    grounded: bool

    @property
    def width(self) -> float:
        """From the leftmost mass to the rightmost."""
        return float(np.ptp(self.places[:, 0]))

    @property
    def height(self) -> float:
        """From the ground to the highest mass."""
        return float(self.places[:, 1].max())

    def blocked(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Whether a mass stands on the straight line between two places."""
        along = end - start
        length = float(np.hypot(*along))
        part = (self.places - start) @ along / length**2
        beside = np.abs((self.places - start) @ np.array([along[1], -along[0]])) / length
        return bool(np.any((part > 0.1) & (part < 0.9) & (beside < 0.3)))


def layout_of(matrix: csr_matrix) -> Layout:
    """Layers by how many connections lead to the ground, each in an order in which few lines cross.

    Args:
        matrix: (C, n), row i: which coordinates stretch connection i.
    """
    pattern = csr_matrix(abs(matrix) > 0, dtype=float)
    to_ground = np.asarray(pattern.sum(axis=1)).reshape(-1) == 1
    neighbours = csr_matrix(pattern.T @ pattern)
    layers = _rows(_distances(matrix, to_ground))
    across = np.zeros(matrix.shape[1])
    for layer in layers:
        across[layer] = np.arange(len(layer)) - (len(layer) - 1) / 2.0
    for sweep in range(_SWEEPS):
        for layer in layers if sweep % 2 == 0 else layers[::-1]:
            wanted = [across[neighbours[dof].indices].mean() for dof in layer]
            ordered = [layer[i] for i in np.argsort(wanted, kind="stable")]
            across[ordered] = np.arange(len(layer)) - (len(layer) - 1) / 2.0
    places = np.empty((matrix.shape[1], 2))
    for level, layer in enumerate(layers, start=1):
        places[layer] = np.column_stack((across[layer], np.full(len(layer), float(level))))
    return Layout(places, bool(to_ground.any()))


def _distances(matrix: csr_matrix, to_ground: np.ndarray) -> np.ndarray:
    """(n,), connections from each coordinate to the ground, by those that were written down first.

    A brace that comes after the storeys leaves them where they are. What no path leads to begins anew.
    """
    # Of a frame in the plane the ends at the ground are told by weights that do not cancel.
    ends = to_ground if to_ground.any() else np.abs(np.asarray(matrix.sum(axis=1)).reshape(-1)) > 1e-9
    rows = [matrix[i].indices for i in range(matrix.shape[0])]
    distance = np.full(matrix.shape[1], -1)
    while (distance < 0).any():
        reached = next((i for i, row in enumerate(rows) if _is_next(distance[row], bool(ends[i]))), None)
        if reached is None:
            distance[np.argmax(distance < 0)] = 0
            continue
        row = rows[reached]
        below = distance[row][distance[row] >= 0]
        distance[row[distance[row] < 0]] = below.min() + 1 if below.size else 0
    return distance


def _is_next(distance: np.ndarray, to_ground: bool) -> bool:
    """Whether a connection leads on from what has a place to what has none."""
    return bool((distance < 0).any() and (to_ground or (distance >= 0).any()))


def _rows(distance: np.ndarray) -> list[np.ndarray]:
    """Coordinates by their distance; a layer of very many is broken into rows."""
    rows = []
    for level in range(int(distance.max()) + 1):
        layer = np.flatnonzero(distance == level)
        count = -(-len(layer) // MOST_IN_A_ROW)
        rows += [part for part in np.array_split(layer, count) if part.size]
    return rows
