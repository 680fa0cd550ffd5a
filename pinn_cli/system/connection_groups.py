"""Connections of one law, where they stand among all of a structure, and the forces of all, linearised."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.sparse import csr_matrix

from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Nonlinearity
from pinn_cli.system.damping import StructuralDamping
from pinn_cli.system.incidence import Incidence


@dataclass(frozen=True, eq=False)
class ConnectionGroup:
    """Connections of one law.

    Attributes:
        nonlinearity: Of all of them, beside their dampers c and springs k.
        incidence: Which coordinates stretch them.
        parts: Of which part of a finite-element model each connection is, or which mode it damps, counted from 0. Its
            law's parameters are then those of the parts, and it has no damper and no spring of its own. None: every
            connection has its own.
    """

    nonlinearity: Nonlinearity
    incidence: Incidence
    parts: tuple[int, ...] | None = None

    @property
    def damps_whole(self) -> bool:
        """Whether they are damping of the structure as a whole, and stand for no device."""
        return isinstance(self.nonlinearity, StructuralDamping)

    def of_rows(self, rows: csr_matrix) -> ConnectionGroup:
        """Structural damping with other rows; where each has not its own parameter, all have the last one's."""
        parts = self.parts or (0,)
        return replace(self, incidence=Incidence(rows), parts=(*parts, *parts[-1:] * rows.shape[0])[: rows.shape[0]])

    @property
    def kinds(self) -> tuple[str, ...]:
        """Of their parameters."""
        return (*(("c", "k") if self.parts is None else ()), *self.nonlinearity.parameters)

    @property
    def shares(self) -> np.ndarray:
        """(C,), which parameter of each of its kinds a connection has, counted from 0."""
        return np.arange(self.incidence.shape[0]) if self.parts is None else np.array(self.parts)

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """Internal force of every connection but what it remembers, N, from elongations, m, and rates, m/s: (..., C).

        Parameters are of all its kinds, each broadcastable against e.
        """
        nonlinear = self.nonlinearity.force(e, de, parameters)
        if self.parts is not None:
            return nonlinear
        return parameters["c"] * de + parameters["k"] * e + nonlinear

    def at_rest(self, parameters: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """(2, C) stiffnesses, N/m, and likewise dampings, N s/m, of connections at rest: own, and by their law."""
        none = np.zeros(self.incidence.shape[0])
        law = self.nonlinearity.stiffness_at_rest(parameters), self.nonlinearity.damping_at_rest(parameters)
        linear = parameters.get("k", none), parameters.get("c", none)
        if self.damps_whole:
            linear, law = (none, none + law[1]), (none, none)
        stiffness, damping = (np.stack([x, none + y]) for x, y in zip(linear, law, strict=True))
        return stiffness, damping


@dataclass(frozen=True, eq=False)
class GroupPart:
    """Where one group's connections, parameters by kind and states, one by one, stand among those of all groups."""

    connections: slice
    parameters: dict[str, slice | np.ndarray]
    states: tuple[slice, ...]

    def of_group(self, parameters: Mapping[str, Array]) -> dict[str, Array]:
        """Those of every connection of the group (..., C), among the parameters (..., members) of every kind."""
        return {kind: parameters[kind][..., places] for kind, places in self.parameters.items()}


def group_parts(groups: Sequence[ConnectionGroup], kinds: Iterable[str]) -> tuple[GroupPart, ...]:
    """Of every group; ``kinds`` are those of the connections' parameters."""
    parts, done, start, hidden = [], dict.fromkeys(kinds, 0), 0, 0
    for group in groups:
        count, members = group.incidence.shape[0], len(np.unique(group.shares))
        places: dict[str, slice | np.ndarray] = {
            kind: slice(done[kind], done[kind] + count) if group.parts is None else done[kind] + group.shares
            for kind in group.kinds
        }
        done |= {kind: done[kind] + members for kind in group.kinds}
        firsts = [hidden + i * count for i in range(group.nonlinearity.states)]
        parts.append(GroupPart(slice(start, start + count), places, tuple(slice(i, i + count) for i in firsts)))
        start, hidden = start + count, hidden + len(firsts) * count
    return tuple(parts)


def carriers(groups: Sequence[ConnectionGroup]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Kind of parameter to the connections that have one, and to which of its members each has, counted from 0."""
    carriers: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    start = 0
    for group in groups:
        connections = start + np.arange(group.incidence.shape[0])
        for kind in group.kinds:
            before, members = carriers.get(kind, (connections[:0], connections[:0]))
            shares = members.max(initial=-1) + 1 + group.shares
            carriers[kind] = np.concatenate([before, connections]), np.concatenate([members, shares])
        start += len(connections)
    return carriers


def slopes(function: Callable[..., torch.Tensor], *given: torch.Tensor) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """What a function makes of tensors, and the derivatives of its sum by each of them, as large as they are.

    Forces are elementwise in time and connection: one reverse pass through their sum gives every derivative of each.
    """
    leaves = [x.detach().requires_grad_() for x in given]
    with torch.enable_grad():
        value = function(*leaves)
        by = torch.autograd.grad(value.sum(), leaves, allow_unused=True, materialize_grads=True)
    return value.detach(), list(by)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The connections' internal force and its derivatives, each (..., C).

    Attributes:
        force: r, N.
        stiffness, damping: dr/de, dr/d(de/dt).
        by_parameter: Kind to dr/d(parameter) of the connections that have it (..., carriers), see
            :attr:`pinn_cli.system.structure.Structure.carriers`; without the mass, on which r does not depend.
    """

    force: torch.Tensor
    stiffness: torch.Tensor
    damping: torch.Tensor
    by_parameter: dict[str, torch.Tensor]
