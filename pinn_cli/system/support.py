"""Whether the springs of a structure hold it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix

from pinn_cli.system.coupling import Coupling

if TYPE_CHECKING:
    from pinn_cli.system.structure import Structure

# What holds a coordinate that nothing else does, against springs of stiffness one; and how many times less than that
# tether alone would let it move a coordinate may move before it counts as held.
_TETHER, _HELD = 1e-10, 100.0


def loose_dofs(structure: Structure) -> list[int]:
    """Coordinates, counted from 0, that can move together without stretching any spring; none where all are held.

    A connection holds if it has a force where it is stretched, or may have: where a value is unknown.
    """
    p = structure.parameters_like(np.empty(0))
    count, _ = structure.incidence.shape
    force = structure.connection_force(np.ones(count), np.zeros(count), p)
    holds = np.isnan(force) | (force != 0)
    holds[structure.memory] = True  # a hidden force holds as well
    springs, coupling = structure.incidence.matrix[holds], Coupling(*[structure.incidence.matrix] * 2)
    # Directions alone: parts of a finite-element model have rows as long as their modes are fast.
    largest = np.maximum(abs(springs).max(axis=1).toarray(), np.finfo(float).tiny)
    springs = csr_matrix(springs.multiply(1.0 / largest))
    rank, n = coupling.rank, structure.coordinates
    # Springs of stiffness one, as a band; where a coordinate is loose its tether alone keeps the factor from zero.
    stiffness = (springs.T @ springs).tocoo()
    row, column = rank[stiffness.row], rank[stiffness.col]
    width = int(np.max(np.abs(row - column), initial=0))
    band = np.zeros((width + 1, n))
    lower = row >= column
    np.add.at(band, ((row - column)[lower], column[lower]), stiffness.data[lower])
    size = float(band[0].max(initial=0.0)) or 1.0
    band[0] += _TETHER * size
    factor = cholesky_banded(band, lower=True)
    # A push that no symmetry hides: what it moves as if nothing but the tether held it is loose.
    push = 1.0 + np.sqrt(np.arange(1.0, n + 1))
    moved = np.abs(cho_solve_banded((factor, True), push)) * size
    return np.sort(coupling.order[moved > push.max() / (_TETHER * _HELD)]).tolist()
