"""What vibrates: masses and connections, and the one equation of motion that simulator, losses and smoother share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch

from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.labels import Labels
from pinn_cli.system.parameters import LINEAR_TITLES, LINEAR_UNITS, MASS, Parameter

if TYPE_CHECKING:
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
class Linearisation:
    """The connections' internal force and its derivatives, each (..., C).

    Attributes:
        force: r, N.
        stiffness, damping: dr/de, dr/d(de/dt).
        by_parameter: Kind to dr/d(parameter) of the connections that have it (..., members of the kind); without the
            mass, on which r does not depend.
    """

    force: torch.Tensor
    stiffness: torch.Tensor
    damping: torch.Tensor
    by_parameter: dict[str, torch.Tensor]

    def by_parameters(self, parameters: Sequence[Parameter], acceleration: torch.Tensor) -> torch.Tensor:
        """(..., p), what single parameters do to the force of their own connection, or to the inertia of their mass.

        Args:
            parameters: p of them.
            acceleration: (..., n), of the masses.
        """
        own = [(acceleration if p.kind == MASS else self.by_parameter[p.kind])[..., p.index] for p in parameters]
        return torch.stack(own, -1) if own else acceleration.new_zeros((*acceleration.shape[:-1], 0))


@dataclass(frozen=True, eq=False)
class Structure:
    """Masses that groups of connections hold together.

    With the elongations e = B u and internal forces r = c de + k e + r_n(e, de), elementwise in connections and time,
    the equation of motion is m a + B' r = f (of a chain: paper, section 2 and appendix, where the last off-diagonal of
    C and K is misprinted). Cost grows with the connections; everything is elementwise over leading dimensions,
    differentiable in state and parameters, and takes torch tensors of any dtype and device or numpy arrays.

    In every method, states, forces and results are (..., n) in SI units. ``parameters=None`` means the structure's own,
    moved to the dtype and device of the state; a mapping that is given must hold every kind, and its entries may be
    (members,) or anything that broadcasts, e.g. (time, members).

    Attributes:
        parameters: "m" kg, (n,); "c" N s/m, "k" N/m, (C,); and those of the nonlinearities, each of the connections
            that have it, in the order of the groups.
        groups: Connections, C in all. A group's law is elementwise, so a law with memory adds its hidden states to the
            group, and a coordinate that is no displacement of a mass differs by its column of the incidence alone.
        labels: What the user calls its coordinates and connections.

    Raises:
        ValueError: The names or the shapes of the parameters do not fit.
    """

    parameters: dict[str, torch.Tensor]
    groups: tuple[ConnectionGroup, ...]
    labels: Labels = field(default_factory=Labels)

    def __post_init__(self) -> None:
        sizes = {MASS: self.groups[0].incidence.shape[1], **{k: len(m) for k, m in self.members.items()}}
        if set(self.parameters) != set(sizes):
            raise ValueError(f"{self._article} has parameters {tuple(sizes)}, not {tuple(self.parameters)}")
        shapes = {name: tuple(value.shape) for name, value in self.parameters.items()}
        if shapes != {name: (sizes[name],) for name in shapes}:
            raise ValueError(f"the parameters of {self._article} are {sizes} numbers, not {shapes}")

    @property
    def _article(self) -> str:
        return f"a {self.nonlinearity_name} structure"

    @property
    def ndof(self) -> int:
        """Number of degrees of freedom, n."""
        return self.parameters[MASS].shape[-1]

    @cached_property
    def incidence(self) -> Incidence:
        """Of all connections."""
        if len(self.groups) == 1:
            return self.groups[0].incidence
        return Incidence.stacked(group.incidence for group in self.groups)

    @cached_property
    def members(self) -> dict[str, np.ndarray]:
        """Kind of the connections' parameters to the connections that have it, counted from 0."""
        ends = np.cumsum([0, *(group.incidence.shape[0] for group in self.groups)])
        kinds = dict.fromkeys(kind for group in self.groups for kind in group.kinds)
        return {
            kind: np.concatenate(
                [np.arange(*ends[g : g + 2]) for g, group in enumerate(self.groups) if kind in group.kinds]
            )
            for kind in kinds
        }

    @property
    def nonlinearity(self) -> Nonlinearity:
        """That of the connections of a structure that has one law.

        Raises:
            ValueError: It has several.
        """
        if len(self.groups) > 1:
            raise ValueError(f"{self._article} has no one nonlinearity")
        return self.groups[0].nonlinearity

    @property
    def nonlinearity_name(self) -> str:
        """What the tables call its laws."""
        return "+".join(dict.fromkeys(group.nonlinearity.name for group in self.groups))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each kind of parameter, powers as ``m^3``."""
        return LINEAR_UNITS | {k: u for group in self.groups for k, u in group.nonlinearity.units.items()}

    @property
    def titles(self) -> dict[str, str]:
        """What a figure calls each kind of parameter."""
        return LINEAR_TITLES | {k: t for group in self.groups for k, t in group.nonlinearity.titles.items()}

    def dof_name(self, index: int) -> str:
        """What people call a DOF, counted from 0: its name, or its number from 1."""
        return self.labels.dof(index)

    def parameter(self, kind: str, index: int) -> Parameter:
        """The parameter of a kind that a mass or a connection has, counted from 0, with its present value."""
        value = float(self.parameters[kind][index])
        if kind == MASS:
            unit, title, label = LINEAR_UNITS[MASS], LINEAR_TITLES[MASS], self.labels.owner(kind, index)
            return Parameter(kind, index, value, unit=unit, title=title, label=label)
        connection = int(self.members[kind][index])
        law = self._law_of[connection]
        unit, title = (LINEAR_UNITS | {**law.units}).get(kind, ""), (LINEAR_TITLES | {**law.titles}).get(kind, "")
        label = self.labels.owner(kind, connection)
        return Parameter(kind, index, value, unit=unit, title=title, label=label)

    @cached_property
    def _law_of(self) -> list[Nonlinearity]:
        """Of every connection."""
        return [group.nonlinearity for group in self.groups for _ in range(group.incidence.shape[0])]

    def every_parameter(self) -> Iterator[Parameter]:
        """All of them, kind by kind."""
        for kind, values in self.parameters.items():
            for index in range(len(values)):
                yield self.parameter(kind, index)

    def ends(self, parameter: Parameter) -> np.ndarray:
        """The DOFs, counted from 0, whose equations of motion contain a parameter."""
        if parameter.kind == MASS:
            return np.array([parameter.index])
        return self.incidence.matrix[self.members[parameter.kind][parameter.index]].indices

    def participation(self, parameters: Sequence[Parameter]) -> np.ndarray:
        """(n, p), how the force of each parameter's own connection, or its mass's inertia, enters the equations."""
        rows = [
            np.eye(1, self.ndof, p.index)[0]
            if p.kind == MASS
            else self.incidence.matrix[self.members[p.kind][p.index]].toarray()[0]
            for p in parameters
        ]
        return np.stack(rows, axis=-1) if rows else np.zeros((self.ndof, 0))

    def elongation(self, x: Array) -> Array:
        """B x, (..., C): of displacements, velocities or accelerations alike."""
        return self.incidence.elongation(x)

    def connection_force(self, e: Array, de: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """Internal force r = c de + k e + r_n(e, de) of every connection (..., C), from elongation and its rate."""
        p = self.parameters_like(e) if parameters is None else parameters
        linear: Array = p["c"] * de + p["k"] * e
        if len(self.groups) == 1:
            return linear + self.groups[0].nonlinearity.force(e, de, p)
        parts, done = [], dict.fromkeys(self.members, 0)
        start = 0
        for group in self.groups:
            count = group.incidence.shape[0]
            own = {kind: p[kind][..., done[kind] : done[kind] + count] for kind in group.kinds}
            done |= {kind: done[kind] + count for kind in group.kinds}
            stretched = slice(start, start + count)
            parts.append(group.nonlinearity.force(e[..., stretched], de[..., stretched], own))
            start += count
        nonlinear: Array = namespace(e).concatenate(parts, -1)
        return linear + nonlinear

    def restoring_force(self, u: Array, v: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """B' r: what the connections pull every DOF back with, from displacement and velocity."""
        return self.incidence.pull(self.connection_force(self.elongation(u), self.elongation(v), parameters))

    def external_force(self, u: Array, v: Array, a: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """The force that this motion takes, m a + restoring force (the paper's physics operator, F[n:2n])."""
        p = self.parameters_like(u) if parameters is None else parameters
        return p[MASS] * a + self.restoring_force(u, v, p)

    def acceleration(self, u: Array, v: Array, f: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """(f - restoring force) / m: the observer equation of an accelerometer."""
        p = self.parameters_like(u) if parameters is None else parameters
        return (f - self.restoring_force(u, v, p)) / p[MASS]

    def linearise(self, u: torch.Tensor, v: torch.Tensor, parameters: Mapping[str, torch.Tensor]) -> Linearisation:
        """The connections linearised about displacements u and velocities v (..., n).

        The internal force is elementwise in time and connection, so one reverse pass through its sum gives every
        derivative.
        """
        e, de = (self.elongation(x).detach().requires_grad_() for x in (u, v))
        local = {
            name: value.detach().expand(*e.shape[:-1], value.shape[-1]).clone().requires_grad_()
            for name, value in parameters.items()
            if name != MASS
        }
        with torch.enable_grad():
            force = self.connection_force(e, de, local)
            gradients = torch.autograd.grad(force.sum(), (e, de, *local.values()), allow_unused=True)
        shaped = (e, de, *local.values())
        filled = [torch.zeros_like(x) if g is None else g for g, x in zip(gradients, shaped, strict=True)]
        return Linearisation(force.detach(), filled[0], filled[1], dict(zip(local, filled[2:], strict=True)))

    def parameters_like(self, x: Array) -> dict[str, Array]:
        """The parameters as x is: numpy arrays of its dtype, or tensors of its dtype and device with their graph."""
        if isinstance(x, np.ndarray):
            return {name: value.detach().cpu().numpy().astype(x.dtype) for name, value in self.parameters.items()}
        return {name: value.to(x) for name, value in self.parameters.items()}

    def with_parameters(self, **tensors: torch.Tensor) -> Structure:
        """The same structure with the named kinds of parameters replaced."""
        return replace(self, parameters={**self.parameters, **tensors})

    def with_values(self, values: Mapping[Parameter, float]) -> Structure:
        """The same structure with single parameters at other values, all of them float64 on the CPU."""
        tensors = {kind: given.detach().cpu().double().clone() for kind, given in self.parameters.items()}
        for parameter, value in values.items():
            tensors[parameter.kind][parameter.index] = value
        return self.with_parameters(**tensors)

    def linearised(self) -> Structure:
        """The same without its nonlinearities: m, c, k stay, kappa or mu go (the paper's 'linear' model error)."""
        groups = tuple(replace(group, nonlinearity=Linear()) for group in self.groups)
        return Structure({name: self.parameters[name] for name in LINEAR_UNITS}, groups, self.labels)
