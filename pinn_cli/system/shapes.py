"""How the DOFs of a structure move with its coordinates: as they are, or as modes have it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_matrix, eye

from pinn_cli.settings.errors import InputError
from pinn_cli.system.array_namespace import Array


@dataclass(frozen=True, eq=False)
class Shapes:
    """u = matrix q, of displacements, velocities and accelerations relative to the ground.

    Records, sensors and forces belong to DOFs, the equations of motion to coordinates.

    Attributes:
        matrix: (dofs, n), how far every DOF moves with every coordinate.
        with_ground: (dofs,), how far every DOF moves with the ground; None: nobody has said.
        stretch: (C', dofs), how the DOFs stretch connections that were added to the modes, C' behind the modes' own.
        residual: How many of the coordinates, the last ones, are static responses and no modes, or modes above a band.
        below: How many modes, the lowest, lie below the band of a record and stand for all that do.
        exact_at: (P,), factors of parts of a finite-element model for which the coordinates hold its modes; None: they
            are near for all.
    """

    matrix: np.ndarray
    with_ground: np.ndarray | None = None
    stretch: csr_matrix | None = None
    residual: int = 0
    below: int = 0
    exact_at: np.ndarray | None = None

    @property
    def modal(self) -> bool:
        """Whether the coordinates are modes; otherwise they are the DOFs."""
        return True

    @property
    def dofs(self) -> int:
        """Number of DOFs."""
        return len(self.matrix)

    @property
    def sparse(self) -> csr_matrix:
        """:attr:`matrix`, of which only what is not zero takes memory."""
        return csr_matrix(self.matrix)

    def of_dofs(self, q: Array) -> Array:
        """Motion of the DOFs (..., dofs), from that of the coordinates (..., n)."""
        return self._product(q, self.matrix.T)

    def onto_coordinates(self, force: Array) -> Array:
        """Forces in the equations of the coordinates (..., n), from forces on the DOFs (..., dofs)."""
        return self._product(force, self.matrix)

    @property
    def scale(self) -> float:
        """How far a DOF moves with its coordinates, root mean square over the DOFs."""
        return float(np.sqrt(np.mean(np.sum(self.matrix**2, axis=1))))

    def _product(self, x: Array, matrix: np.ndarray) -> Array:
        other = matrix if isinstance(x, np.ndarray) else torch.as_tensor(matrix.copy()).to(x)
        return x @ other

    def check_ground(self) -> None:
        """See that it is known how the ground moves the DOFs.

        Raises:
            InputError: Naming ``system.ground``: it is not.
        """
        if self.with_ground is None:
            allowed = "the DOFs that move with the ground, such as 1::2 (every second one from the first)"
            raise InputError(
                "system.ground", None, allowed, "the matrices do not say in which direction the ground moves"
            )


class OfMasses(Shapes):
    """Those of coordinates that are the DOFs: every product is what was multiplied.

    Args:
        with_ground: (n,).
    """

    def __init__(self, with_ground: np.ndarray) -> None:
        object.__setattr__(self, "with_ground", with_ground)

    @cached_property
    def matrix(self) -> np.ndarray:
        """(n, n), the identity."""
        return np.eye(self.dofs)

    @property
    def modal(self) -> bool:
        """See :attr:`Shapes.modal`."""
        return False

    @property
    def dofs(self) -> int:
        """See :attr:`Shapes.dofs`."""
        assert self.with_ground is not None
        return len(self.with_ground)

    @property
    def sparse(self) -> csr_matrix:
        """See :attr:`Shapes.sparse`."""
        return csr_matrix(eye(self.dofs, format="csr"))

    @property
    def scale(self) -> float:
        """See :attr:`Shapes.scale`."""
        return 1.0

    def of_dofs(self, q: Array) -> Array:
        """See :meth:`Shapes.of_dofs`."""
        return q

    def onto_coordinates(self, force: Array) -> Array:
        """See :meth:`Shapes.onto_coordinates`."""
        return force
