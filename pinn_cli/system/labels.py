"""Names of coordinates and connections."""

from __future__ import annotations

from dataclasses import dataclass

from pinn_cli.system.parameters import MASS


@dataclass(frozen=True)
class Labels:
    """What a user calls the coordinates and the connections of a structure; of one that is numbered, nothing.

    Attributes:
        dofs: Of the coordinates, n; empty: they go by their numbers, from 1.
        connections: Of all connections, in the order of the groups; empty: they go by their numbers.
    """

    dofs: tuple[str, ...] = ()
    connections: tuple[str, ...] = ()

    def dof(self, index: int) -> str:
        """What people call a coordinate, counted from 0: its name, or its number from 1."""
        return self.dofs[index] if self.dofs else str(index + 1)

    def owner(self, kind: str, index: int) -> str:
        """Name of the mass, or of the connection counted among all, that has a parameter; "" if it has none."""
        names = self.dofs if kind == MASS else self.connections
        return names[index] if names else ""
