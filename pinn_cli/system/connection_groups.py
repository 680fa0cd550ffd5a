"""Connections of one law, and where they stand among all of a structure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pinn_cli.system.incidence import Incidence

if TYPE_CHECKING:
    from pinn_cli.system.array_namespace import Array
    from pinn_cli.system.connection.base import Nonlinearity


@dataclass(frozen=True, eq=False)
class ConnectionGroup:
    """Connections of one law.

    Attributes:
        nonlinearity: Of all of them, beside their dampers c and springs k.
        incidence: Which coordinates stretch them.
    """

    nonlinearity: Nonlinearity
    incidence: Incidence

    @property
    def kinds(self) -> tuple[str, ...]:
        """Of their parameters."""
        return ("c", "k", *self.nonlinearity.parameters)


@dataclass(frozen=True, eq=False)
class GroupPart:
    """Where one group's connections, parameters by kind and hidden forces stand among those of all groups."""

    connections: slice
    parameters: dict[str, slice]
    hidden: slice

    def own(self, parameters: Mapping[str, Array]) -> dict[str, Array]:
        """The group's own among the parameters (..., members) of every kind."""
        return {kind: parameters[kind][..., places] for kind, places in self.parameters.items()}


def group_parts(groups: Sequence[ConnectionGroup], kinds: Iterable[str]) -> tuple[GroupPart, ...]:
    """Of every group; ``kinds`` are those of the connections' parameters."""
    parts, done, start, hidden = [], dict.fromkeys(kinds, 0), 0, 0
    for group in groups:
        count = group.incidence.shape[0]
        own = {kind: slice(done[kind], done[kind] + count) for kind in group.kinds}
        done |= {kind: done[kind] + count for kind in group.kinds}
        remembers = count if group.nonlinearity.has_memory else 0
        parts.append(GroupPart(slice(start, start + count), own, slice(hidden, hidden + remembers)))
        start, hidden = start + count, hidden + remembers
    return tuple(parts)
