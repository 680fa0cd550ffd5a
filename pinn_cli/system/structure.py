"""What vibrates: masses and connections, and the one equation of motion that simulator, losses and smoother share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from scipy.sparse import csr_matrix, eye, hstack, vstack
from scipy.sparse.linalg import norm as sparse_norm

from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.connection.nonlinearity import Hysteresis, Nonlinearity
from pinn_cli.system.connection_groups import ConnectionGroup, GroupPart, Linearisation, carriers, group_parts, slopes
from pinn_cli.system.damping import StructuralDamping
from pinn_cli.system.incidence import Incidence, Pairs
from pinn_cli.system.parameters import LINEAR_TITLES, LINEAR_UNITS, MASS, Labels, Parameter
from pinn_cli.system.shapes import OfMasses, Shapes


class Reduction(Protocol):
    """What made the coordinates of a structure of a finite-element model, and makes others."""

    @property
    def structure(self) -> Structure:
        """As the model gives it."""

    def at(self, factors: np.ndarray) -> Structure:
        """The model in as many coordinates that are exact where its parts have these factors (P,)."""

    def onto(self, other: Any) -> np.ndarray:
        """(n, n), from coordinates to those of another reduction of the model."""


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
            that have it, in the order of the groups; "factor" of parts of a finite-element model, and the damping
            of the structure as a whole ("zeta", "a_0", "a_1"), whose connections come last and have neither c nor k.
        groups: Connections, C in all. A group's law is elementwise, so a law with memory adds its hidden states to the
            group, and a coordinate that is no displacement of a mass differs by its column of the incidence alone.
        labels: What the user calls its coordinates and connections.
        influence: (n,), how far each coordinate moves with the ground; None: all of them, by one.
        mode_shapes: How the DOFs move with the coordinates, where these are modes; None: they are the DOFs.
        pairs: Of DOFs whose drift is to be told as well; None: none.
        reduction: What made the coordinates; None: they are no reduction with factors, or the model is not at hand.
        by_supports: (C', S), how far supports that move stretch the first C' connections, which pull at their other
            ends alone; None: none moves. A motion (..., n) is one of coordinates beside supports at rest; one
            (..., n + S) has that of the supports behind the coordinates'.

    Raises:
        ValueError: The names or the shapes of the parameters do not fit.
    """

    parameters: dict[str, torch.Tensor]
    groups: tuple[ConnectionGroup, ...]
    labels: Labels = field(default_factory=Labels)
    influence: np.ndarray | None = None
    mode_shapes: Shapes | None = None
    pairs: Pairs | None = None
    reduction: Reduction | None = None
    by_supports: csr_matrix | None = None

    def __post_init__(self) -> None:
        sizes = {MASS: self.groups[0].incidence.shape[1], **{k: len(m) for k, m in self.members.items()}}
        article = f"a {self.nonlinearity_name} structure"
        if set(self.parameters) != set(sizes):
            raise ValueError(f"{article} has parameters {tuple(sizes)}, not {tuple(self.parameters)}")
        shapes = {name: tuple(value.shape) for name, value in self.parameters.items()}
        if shapes != {name: (sizes[name],) for name in shapes}:
            raise ValueError(f"the parameters of {article} are {sizes} numbers, not {shapes}")

    @property
    def coordinates(self) -> int:
        """Their number, n."""
        return self.parameters[MASS].shape[-1]

    @property
    def ndof(self) -> int:
        """Number of degrees of freedom, of which there are records: n, unless the coordinates are modes."""
        return self.shapes.dofs

    @cached_property
    def shapes(self) -> Shapes:
        """How the DOFs move with the coordinates."""
        return OfMasses(self.with_ground) if self.mode_shapes is None else self.mode_shapes

    @property
    def is_modal(self) -> bool:
        """Whether the coordinates are modes, and no DOFs."""
        return self.shapes.modal

    @cached_property
    def incidence(self) -> Incidence:
        """Of all connections."""
        if len(self.groups) == 1:
            return self.groups[0].incidence
        return Incidence(vstack([group.incidence.matrix for group in self.groups], format="csr"))

    @property
    def supports(self) -> int:
        """Their number S, of those that move."""
        return 0 if self.by_supports is None else self.by_supports.shape[1]

    @cached_property
    def stretch(self) -> Incidence:
        """(C, n + S), how coordinates and supports stretch the connections."""
        if self.by_supports is None:
            return self.incidence
        beyond = csr_matrix((self.incidence.shape[0] - self.by_supports.shape[0], self.supports))
        return Incidence(hstack([self.incidence.matrix, vstack([self.by_supports, beyond])], format="csr"))

    @cached_property
    def carriers(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Kind to the connections that have a parameter of it, and to which of its members each has, from 0."""
        return carriers(self.groups)

    @cached_property
    def members(self) -> dict[str, np.ndarray]:
        """Kind of the connections' parameters to the connection of each member; of several that share it the first."""
        return {k: at[np.unique(which, return_index=True)[1]] for k, (at, which) in self.carriers.items()}

    @property
    def has_linear_laws(self) -> bool:
        """Whether every connection's law is linear, whatever its parameters."""
        return all(isinstance(group.nonlinearity, Linear) for group in self.groups)

    @property
    def nonlinearity_name(self) -> str:
        """What the tables call its laws."""
        return "+".join(dict.fromkeys(group.nonlinearity.name for group in self.groups))

    def dof_name(self, index: int) -> str:
        """What people call a DOF, counted from 0: its name, or its number from 1."""
        return self.labels.dofs[index] if self.labels.dofs else str(index + 1)

    def parameter(self, kind: str, index: int) -> Parameter:
        """The parameter of a kind that a mass or a connection has, counted from 0, with its present value."""
        value = float(self.parameters[kind][index])
        if kind == MASS:
            unit, title, label = LINEAR_UNITS[MASS], LINEAR_TITLES[MASS], self.labels.owner(kind, index)
            return Parameter(kind, index, value, unit=unit, title=title, label=label)
        connection = int(self.members[kind][index])
        law = self.laws[connection]
        unit, title = (LINEAR_UNITS | {**law.units}).get(kind, ""), (LINEAR_TITLES | {**law.titles}).get(kind, "")
        if isinstance(law, StructuralDamping):
            return Parameter(kind, index, value, unit=unit, title=title, alone=len(self.parameters[kind]) == 1)
        label = self.labels.owner(kind, connection)
        curve = "".join(f"{kinds[0]} of connection {connection}" for kinds in law.curves if kind in kinds)
        return Parameter(kind, index, value, unit=unit, title=title, label=label, curve=curve)

    def every_parameter(self) -> Iterator[Parameter]:
        """All of them, kind by kind."""
        for kind, values in self.parameters.items():
            for index in range(len(values)):
                yield self.parameter(kind, index)

    def ends(self, parameter: Parameter) -> np.ndarray:
        """The coordinates, counted from 0, whose equations of motion contain a parameter."""
        if parameter.kind == MASS:
            return np.array([parameter.index])
        connections, which = self.carriers[parameter.kind]
        return np.unique(self.incidence.matrix[connections[which == parameter.index]].indices)

    def elongation(self, x: Array) -> Array:
        """B x, (..., C): of displacements, velocities or accelerations alike, with the supports' or without."""
        return (self.incidence if x.shape[-1] == self.coordinates else self.stretch).elongation(x)

    @cached_property
    def with_ground(self) -> np.ndarray:
        """(n,), iota: how far each coordinate moves with the ground."""
        return np.ones(self.coordinates) if self.influence is None else np.asarray(self.influence, dtype=np.float64)

    @cached_property
    def memory(self) -> np.ndarray:
        """(h,), the connection that every hidden function, a state of its law, belongs to."""
        connections = np.arange(self.incidence.shape[0])
        states = [connections[part.connections] for part in self.parts for _ in part.states]
        return np.concatenate([np.zeros(0, dtype=np.int64), *states])

    @cached_property
    def hidden_force(self) -> np.ndarray:
        """(C,), which hidden function is the force that a connection remembers; -1 where it remembers none."""
        out, forces = np.full(self.incidence.shape[0], -1), np.flatnonzero(self.state_number == 0)
        out[self.memory[forces]] = forces
        return out

    @cached_property
    def state_number(self) -> np.ndarray:
        """(h,), which of its law's states every hidden function is: 0 of a hidden force."""
        numbers = [np.full(at.stop - at.start, i) for part in self.parts for i, at in enumerate(part.states)]
        return np.concatenate([np.zeros(0, dtype=np.int64), *numbers])

    @cached_property
    def added(self) -> np.ndarray:
        """(C',), the connections that somebody wrote down: all of them, but for the springs of modes and for parts."""
        first = self.groups[0].incidence.shape[0] if self.is_modal else 0
        return np.arange(first, len(self.parameters["k"]))

    @property
    def drift_names(self) -> tuple[str, ...]:
        """Of all drifts, D: those of :attr:`added`, then those of :attr:`pairs`."""
        names = tuple(self.labels.connection(i) for i in self.added.tolist())
        return names + (() if self.pairs is None else self.pairs.names)

    @cached_property
    def drifts(self) -> csr_matrix:
        """(D, n + S), how the coordinates and supports make them."""
        return self._with_pairs(self.stretch.matrix[self.added], self.shapes.sparse)

    @cached_property
    def drifts_of_dofs(self) -> csr_matrix:
        """(D, dofs + S), how the DOFs and supports make them."""
        stretch = self.stretch.matrix[self.added] if self.shapes.stretch is None else self.shapes.stretch
        return self._with_pairs(stretch, eye(self.ndof, format="csr"))

    def _with_pairs(self, stretch: csr_matrix, of_dofs: csr_matrix) -> csr_matrix:
        """Drifts of connections, and behind them those of pairs, of DOFs that move so (dofs, n), beside supports."""
        if self.pairs is None:
            return stretch
        weights = csr_matrix(self.pairs.weights @ of_dofs)
        return vstack([stretch, hstack([weights, csr_matrix((weights.shape[0], self.supports))])], format="csr")

    @cached_property
    def laws(self) -> tuple[Nonlinearity, ...]:
        """Of every connection (C,)."""
        return tuple(group.nonlinearity for group in self.groups for _ in range(group.incidence.shape[0]))

    @cached_property
    def parts(self) -> tuple[GroupPart, ...]:
        """Where the connections, the parameters and the hidden forces of each group stand among all."""
        return group_parts(self.groups, self.members)

    def connection_force(
        self, e: Array, de: Array, parameters: Mapping[str, Array] | None = None, z: Array | None = None
    ) -> Array:
        """Internal force r = c de + k e + r_n(e, de) + z of every connection (..., C), of elongations and their rates.

        Hidden forces z (..., h), N, are of the connections that have memory; None where none has.
        """
        p = self.parameters_like(e) if parameters is None else parameters
        of_groups = [p] if len(self.groups) == 1 else [part.of_group(p) for part in self.parts]
        return self._connection_force(e, de, of_groups, z)

    def _connection_force(
        self, e: Array, de: Array, of_groups: Sequence[Mapping[str, Array]], z: Array | None = None
    ) -> Array:
        """The same from the parameters of every group's connections (..., C of the group)."""
        if len(self.groups) == 1:
            force = self.groups[0].force(e, de, of_groups[0])
            states = self.parts[0].states
            return force if z is None or not states else force + z[..., states[0]]
        forces = []
        for group, part, values in zip(self.groups, self.parts, of_groups, strict=True):
            force = group.force(e[..., part.connections], de[..., part.connections], values)
            forces.append(force if z is None or not part.states else force + z[..., part.states[0]])
        return namespace(e).concatenate(forces, -1)

    def unresolved_force(self, e: Array, de: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """Standard deviation of what their laws are too coarse for, see :meth:`Nonlinearity.unresolved`, (..., C)."""
        p = self.parameters_like(e) if parameters is None else parameters
        places = [part.connections for part in self.parts]
        groups = zip(self.groups, self.parts, places, strict=True)
        found = [g.nonlinearity.unresolved(e[..., at], de[..., at], part.of_group(p)) for g, part, at in groups]
        return namespace(e).concatenate(found, -1)

    def hidden_rate(self, e: Array, de: Array, z: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """dz/dt of the hidden forces (..., h), N/s, from elongations and rates (..., C) and the hidden forces."""
        p = self.parameters_like(e) if parameters is None else parameters
        return self._hidden_rate(e, de, z, [part.of_group(p) for part in self.parts])

    def _hidden_rate(self, e: Array, de: Array, z: Array, of_groups: Sequence[Mapping[str, Array]]) -> Array:
        """The same from the parameters of every group's connections (..., C of the group)."""
        rates: list[Array] = []
        for group, part, values in zip(self.groups, self.parts, of_groups, strict=True):
            if isinstance(group.nonlinearity, Hysteresis):
                at, states = part.connections, [z[..., places] for places in part.states]
                rates += group.nonlinearity.rate(e[..., at], de[..., at], states, values)
        return namespace(e).concatenate(rates, -1)

    def laws_of(self, parameters: Mapping[str, Array]) -> tuple[Callable[..., Array], Callable[..., Array]]:
        """:meth:`connection_force` and :meth:`hidden_rate` of (e, de, z) at these parameters, sorted out once."""
        of_groups = [part.of_group(parameters) for part in self.parts]
        return (
            lambda e, de, z: self._connection_force(e, de, of_groups, z),
            lambda e, de, z: self._hidden_rate(e, de, z, of_groups),
        )

    def restoring_force(
        self, u: Array, v: Array, parameters: Mapping[str, Array] | None = None, z: Array | None = None
    ) -> Array:
        """B' r: what the connections pull every DOF back with, from displacement, velocity and hidden forces."""
        return self.incidence.pull(self.connection_force(self.elongation(u), self.elongation(v), parameters, z))

    def external_force(self, u: Array, v: Array, a: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """The force that this motion takes, m a + restoring force (the paper's physics operator, F[n:2n])."""
        p = self.parameters_like(u) if parameters is None else parameters
        return p[MASS] * a + self.restoring_force(u, v, p)

    def acceleration(
        self, u: Array, v: Array, f: Array, parameters: Mapping[str, Array] | None = None, z: Array | None = None
    ) -> Array:
        """(f - restoring force) / m: the observer equation of an accelerometer."""
        p = self.parameters_like(u) if parameters is None else parameters
        return (f - self.restoring_force(u, v, p, z)) / p[MASS]

    def linearise(self, u: torch.Tensor, v: torch.Tensor, parameters: Mapping[str, torch.Tensor]) -> Linearisation:
        """The connections linearised about displacements u and velocities v (..., n)."""
        return self.linearise_connections(self.elongation(u), self.elongation(v), parameters)

    def linearise_connections(
        self, e: torch.Tensor, de: torch.Tensor, parameters: Mapping[str, torch.Tensor]
    ) -> Linearisation:
        """The same about elongations e and their rates de (..., C)."""
        of_groups = [part.of_group(parameters) for part in self.parts]

        def force(e: torch.Tensor, de: torch.Tensor, *values: torch.Tensor) -> torch.Tensor:
            rest = iter(values)
            return self._connection_force(e, de, [{kind: next(rest) for kind in given} for given in of_groups])

        value, by = slopes(force, e, de, *(x.expand(*e.shape[:-1], -1) for given in of_groups for x in given.values()))
        slope_of = list(zip([kind for given in of_groups for kind in given], by[2:], strict=True))
        by_parameter = {k: torch.cat([x for other, x in slope_of if other == k], -1) for k in self.carriers}
        return Linearisation(value, by[0], by[1], by_parameter)

    def parameters_like(self, x: Array) -> dict[str, Array]:
        """The parameters as x is: numpy arrays of its dtype, or tensors of its dtype and device with their graph."""
        if isinstance(x, np.ndarray):
            return {name: value.detach().cpu().numpy().astype(x.dtype) for name, value in self.parameters.items()}
        return {name: value.to(x) for name, value in self.parameters.items()}

    def with_parameters(self, **tensors: torch.Tensor) -> Structure:
        """The same structure with the named kinds of parameters replaced, and its own modes damped."""
        return replace(self, parameters={**self.parameters, **tensors}).present()

    def damping_change(self, other: Structure) -> float:
        """How far the damping of the whole and another's are apart for equal parameters, relative, 0 without any."""
        differences = [0.0]
        for mine, theirs in zip(self.groups, other.groups, strict=True):
            if mine.damps_whole:
                rates, other_rates = (g.incidence.matrix.T @ g.incidence.matrix for g in (mine, theirs))
                differences.append(float(sparse_norm(rates - other_rates) / sparse_norm(rates)))
        return max(differences)

    @property
    def is_damped_as_whole(self) -> bool:
        """Whether it has ratios of its modes or Rayleigh damping, beside the dampers of its connections."""
        return any(group.damps_whole for group in self.groups)

    def present(self, values: Mapping[str, np.ndarray] | None = None) -> Structure:
        """The same with the damping of the whole in the modes of some masses and stiffnesses, its parameters as before.

        Those are its own unless values by kind are given; where they are no structure, the rows stay as they are.
        """
        if not self.is_damped_as_whole:
            return self
        at = {**self.parameters_like(np.empty(0)), **(values or {})}
        mass, stiffness = at[MASS], self.at_rest(at)[0].sum(axis=0)
        holds = np.array([not isinstance(law, StructuralDamping) for law in self.laws])
        if not np.isfinite(stiffness[holds]).all() or not (mass > 0).all():
            return self
        stretch = self.incidence.matrix[holds]
        groups = tuple(
            group.of_rows(group.nonlinearity.rows(mass, stretch, stiffness[holds]))
            if isinstance(group.nonlinearity, StructuralDamping)
            else group
            for group in self.groups
        )
        return replace(self, groups=groups)

    def with_values(self, values: Mapping[Parameter, float]) -> Structure:
        """The same structure with single parameters at other values, all of them float64 on the CPU."""
        tensors = {kind: given.detach().cpu().double().clone() for kind, given in self.parameters.items()}
        for parameter, value in values.items():
            tensors[parameter.kind][parameter.index] = value
        return self.with_parameters(**tensors)

    def turning_over(self, speed: float) -> Structure:
        """The same with contacts that creep below a speed (m/s) where they stick; its parameters are shared."""
        return self.with_laws([group.nonlinearity.turning_over(speed) for group in self.groups])

    def moving_by(self, elongation: float) -> Structure:
        """The same with laws whose states are counted at the size of a motion, m; its parameters are shared."""
        return self.with_laws([group.nonlinearity.moving_by(elongation) for group in self.groups])

    def with_laws(self, laws: Sequence[Nonlinearity]) -> Structure:
        """The same with other laws of every group: terms of curves are those with which they do what they did."""
        if all(law is group.nonlinearity for law, group in zip(laws, self.groups, strict=True)):
            return self
        groups = (replace(group, nonlinearity=law) for law, group in zip(laws, self.groups, strict=True))
        values, before = dict(self.parameters), self.parameters_like(np.empty(0))
        for law, group, part in zip(laws, self.groups, self.parts, strict=True):
            if law is not group.nonlinearity:
                for kind, terms in law.terms_of(group.nonlinearity, part.of_group(before)).items():
                    values[kind] = values[kind].clone()
                    values[kind][part.parameters[kind]] = torch.as_tensor(terms).to(values[kind])
        return replace(self, parameters=values, groups=tuple(groups))

    def linearised(self) -> Structure:
        """The same without its nonlinearities: m, c, k stay, kappa or mu go (the paper's 'linear' model error)."""
        groups = tuple(g if g.parts is not None else replace(g, nonlinearity=Linear()) for g in self.groups)
        kinds = (*LINEAR_UNITS, *(kind for group in groups for kind in group.nonlinearity.parameters))
        return replace(self, parameters={kind: self.parameters[kind] for kind in kinds}, groups=groups)

    def at_rest(self, parameters: Mapping[str, np.ndarray] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness, N/m, and damping, N s/m, of every connection at rest, each (2, C): its own, and by its law.

        The law's includes what a hidden force adds that follows the elongation. ``parameters=None``: the structure's.
        """
        p = self.parameters_like(np.empty(0)) if parameters is None else parameters
        by_group = [group.at_rest(part.of_group(p)) for group, part in zip(self.groups, self.parts, strict=True)]
        stiffness, damping = (np.concatenate(x, axis=1) for x in zip(*by_group, strict=True))
        return stiffness, damping

    def creates_energy(self, parameters: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
        """(C,) bool: connections whose hysteresis allows a cycle that gives more energy than it takes."""
        p = self.parameters_like(np.empty(0)) if parameters is None else parameters
        out = np.zeros(self.incidence.shape[0], dtype=bool)
        for group, part in zip(self.groups, self.parts, strict=True):
            if isinstance(group.nonlinearity, Hysteresis):
                out[part.connections] = group.nonlinearity.creates_energy(part.of_group(p))
        return out
