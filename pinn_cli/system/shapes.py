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

    Records, sensors and forces belong to DOFs, the equations of motion to coordinates. Where these are the DOFs, every
    product is what was multiplied.

    Attributes:
        modes: (dofs, n), how far every DOF moves with every mode; None: the coordinates are the DOFs.
        with_ground: (dofs,), how far every DOF moves with the ground; None: nobody has said.
        stretch: (C', dofs), how the DOFs stretch connections that were added to the modes, C' behind the modes' own.
        residual: How many of the coordinates, the last ones, are static responses and no modes, or modes above a band.
        below: How many modes, the lowest, lie below the band of a record and stand for all that do.
        exact_at: (P,), factors of parts of a finite-element model for which the coordinates hold its modes; None: they
            are near for all.
    """

    modes: np.ndarray | None
    with_ground: np.ndarray | None = None
    stretch: csr_matrix | None = None
    residual: int = 0
    below: int = 0
    exact_at: np.ndarray | None = None

    @property
    def modal(self) -> bool:
        """Whether the coordinates are modes; otherwise they are the DOFs."""
        return self.modes is not None

    @property
    def dofs(self) -> int:
        """Number of DOFs."""
        by_dof = self.with_ground if self.modes is None else self.modes
        assert by_dof is not None
        return len(by_dof)

    @cached_property
    def matrix(self) -> np.ndarray:
        """(dofs, n), how far every DOF moves with every coordinate."""
        return np.eye(self.dofs) if self.modes is None else self.modes

    @property
    def sparse(self) -> csr_matrix:
        """:attr:`matrix`, of which only what is not zero takes memory."""
        return csr_matrix(eye(self.dofs, format="csr") if self.modes is None else self.modes)

    def of_dofs(self, q: Array) -> Array:
        """Motion of the DOFs (..., dofs), from that of the coordinates (..., n)."""
        return q if self.modes is None else self._product(q, self.modes.T)

    def onto_coordinates(self, force: Array) -> Array:
        """Forces in the equations of the coordinates (..., n), from forces on the DOFs (..., dofs)."""
        return force if self.modes is None else self._product(force, self.modes)

    @property
    def scale(self) -> float:
        """How far a DOF moves with its coordinates, root mean square over the DOFs."""
        return 1.0 if self.modes is None else float(np.sqrt(np.mean(np.sum(self.modes**2, axis=1))))

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
