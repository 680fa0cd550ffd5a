"""Names of coordinates and connections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pinn_cli.system.damping import WHOLE
from pinn_cli.system.parameters import FACTOR, MASS

if TYPE_CHECKING:
    from pinn_cli.system.parameters import Parameter


@dataclass(frozen=True)
class Labels:
    """What a user calls the coordinates and the connections of a structure; of one that is numbered, nothing.

    Attributes:
        dofs: Of the coordinates, n; empty: they go by their numbers, from 1.
        connections: Of all connections, in the order of the groups; empty: they go by their numbers.
        modes: Of the masses and of their springs, where the coordinates are modes and not the DOFs.
        supports: Of the supports that move.
    """

    dofs: tuple[str, ...] = ()
    connections: tuple[str, ...] = ()
    modes: tuple[str, ...] = ()
    supports: tuple[str, ...] = ()

    def dof(self, index: int) -> str:
        """What people call a coordinate, counted from 0: its name, or its number from 1."""
        return self.dofs[index] if self.dofs else str(index + 1)

    def connection(self, index: int) -> str:
        """What people call a connection, counted from 0: its name, or its number from 1."""
        return self.connections[index] if self.connections else str(index + 1)

    def owner(self, kind: str, index: int) -> str:
        """Name of the mass, or of the connection counted among all, that has a parameter; "" if it has none."""
        names = (self.modes or self.dofs) if kind == MASS else self.connections
        return names[index] if names else ""

    def setting(self, parameter: Parameter) -> str:
        """Where a user gives a parameter: ``system.k``, or of what has a name ``system.connections.brace.k``."""
        if parameter.kind in WHOLE:
            return "system.damping"
        if not parameter.label:
            return f"system.{parameter.kind}"
        if parameter.label in self.modes:
            return "system.damping_ratio" if parameter.kind == "c" else "system.modes"
        if parameter.kind == FACTOR:
            return f"system.factors.{parameter.label}"
        return (
            f"system.mass.{parameter.label}"
            if parameter.kind == MASS
            else (f"system.connections.{parameter.label}.{parameter.kind}")
        )
