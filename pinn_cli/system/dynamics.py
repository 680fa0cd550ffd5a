"""All unknown functions of time of a structure and its inputs, and the one equation that each of them has to obey.

The functions are the columns of a network: the coordinates q, the hidden forces z of connections with memory, the
ground's acceleration, and forces that nobody measured. Their equations are rows of the
same number:

    m (q'' + iota a_g) + B' r(B q, B q', z) - w = f       motion, N
    (z' - h(B q, B q', z)) / rate = 0                     memory, N
    a_g'' / edge^2 + 2 a_g' / edge + a_g = white noise    the ground as a Gaussian process, m/s^2
    (tau / 2 zeta)^2 w'' + tau w' + w = white noise       an unknown force as a Gaussian process, N

Where the coordinates are modes, a force on a DOF is in all their equations. A measured one is then a function as well,
with a sensor of its own and a process like the ground's: its errors are common to all modes. So it is where a load cell
has a gain in doubt, a delay, or samples that are missing.

The state of a sensor's filter is a function without an equation here: it is in the sensor's rows.

Rows of first order are divided by a rate of the record, so that all of them are forces. The ground's process is flat up
to the edge of the record's band and falls off above it: between samples it does what a band-limited signal does. An
unknown force's has its edge at 2 zeta / tau, which is inferred; so has that of a ground that nobody measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_matrix, hstack, vstack
from torch import Tensor

from pinn_cli.system.connection_groups import Linearisation, slopes
from pinn_cli.system.coupling import Coupling
from pinn_cli.system.functions import Functions, Jet
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import MASS


@dataclass(frozen=True, eq=False)
class Dynamics(Functions):
    """Equations of a structure under its inputs, in all unknown functions of time."""

    @cached_property
    def _pushed(self) -> csr_matrix:
        """(forces, n), how those enter the equations of the coordinates."""
        return csr_matrix(self.structure.shapes.sparse[np.array(self.loaded, dtype=int)])

    @cached_property
    def has_mass(self) -> Tensor:
        """(N,) bool: the coordinates."""
        return torch.arange(self.size) < self.ndof

    def mass(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """(N,), of every function's second derivative in its own equation."""
        mass = self.padded(parameters[MASS])
        for functions, edge in ((self.smooth, self.inputs.edge), (self.forces, self.inputs.force_edge)):
            places = torch.arange(functions.start, functions.stop, device=mass.device)
            mass = mass.index_fill(0, places, edge**-2) if len(places) else mass
        return mass

    def padded(self, values: Tensor) -> Tensor:
        """(..., n) of the coordinates as (..., N), 0 of the other functions; (..., N) as they are."""
        more = self.size - values.shape[-1]
        return torch.cat((values, values.new_zeros((*values.shape[:-1], more))), -1) if more else values

    def inertial_acceleration(self, jet: Jet) -> Tensor:
        """Q'' + iota a_g, (..., n): what the masses feel."""
        motion = jet.curvature[..., : self.ndof]
        return motion if not self.inputs.ground else motion + jet.value[..., self.ground] * self._influence(motion)

    def _influence(self, like: Tensor) -> Tensor:
        return torch.as_tensor(self.structure.with_ground).to(like)

    def residual(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """Left-hand sides of all equations (..., N), N; of those of the motion f is still to be taken off."""
        structure = self.structure
        if self.is_plain:
            return structure.external_force(*jet, parameters)
        u, v, z = self.stretching(jet.value), self.stretching(jet.rate), jet.value[..., self.hidden]
        motion = parameters[MASS] * self.inertial_acceleration(jet) + structure.restoring_force(u, v, parameters, z)
        rows = [motion]
        if z.shape[-1]:
            e, de = structure.elongation(u), structure.elongation(v)
            rows.append((jet.rate[..., self.hidden] - structure.hidden_rate(e, de, z, parameters)) / self.inputs.rate)
        if self.smooth.stop > self.smooth.start:
            value, rate, curvature = (x[..., self.smooth] for x in jet)
            rows.append(curvature / self.inputs.edge**2 + 2.0 * rate / self.inputs.edge + value)
        if self.loaded:
            rows[0] = motion - jet.value[..., self.acting] @ torch.as_tensor(self._pushed.toarray()).to(motion)
        if self.inputs.unmeasured:
            force, rate, curvature = (x[..., self.forces] for x in jet)
            rows.append(curvature / self.inputs.force_edge**2 + self.inputs.correlation_time * rate + force)
        if self.inputs.filters:
            rows.append(torch.zeros_like(jet.value[..., self.filters]))
        return torch.cat(rows, -1)

    def external_force(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """(..., dofs), N: the force on every DOF, of one that nobody measured what its function says.

        Where the coordinates are modes, the forces of DOFs are what their functions say, and the others are 0.
        """
        if self.is_plain:
            return self.structure.external_force(*jet, parameters)
        if self.structure.is_modal:
            return self.on_dofs(jet)
        force = self.residual(jet, parameters)[..., : self.ndof].clone()
        force[..., self.loaded] = jet.value[..., self.acting]
        return force

    def connection_force(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """(..., C), N, of every connection."""
        e, de = (self.structure.elongation(self.stretching(x)) for x in (jet.value, jet.rate))
        z = jet.value[..., self.hidden] if len(self.structure.memory) else None
        return self.structure.connection_force(e, de, parameters, z)

    def linearise(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Linearisation:
        """The equations linearised: stiffness and damping of the terms of :attr:`coupling`, each (..., T)."""
        structure = self.structure
        if self.is_plain:
            return structure.linearise(jet.value, jet.rate, parameters)
        u, v, z = self.stretching(jet.value), self.stretching(jet.rate), jet.value[..., self.hidden]
        linear = structure.linearise(u, v, parameters)
        terms, by_parameter = [(linear.stiffness, linear.damping)], dict(linear.by_parameter)
        if z.shape[-1]:
            memory = self._linearised_memory(u, v, z, parameters)
            forces = torch.ones_like(z[..., self._is_force])
            own = torch.as_tensor(np.equal(*self._recalled)).to(u).expand(*u.shape[:-1], -1)
            terms += [(memory["z"], own / self.inputs.rate), (forces, torch.zeros_like(forces))]
            terms.append((memory["e"], memory["de"]))
            # A parameter of a memory is in no force: where laws share a kind, each connection has one of the two.
            by_parameter |= {kind: by_parameter[kind] + memory[kind] for kind in self._remembered}
        if self.inputs.ground:
            moved = (parameters[MASS] * self._influence(parameters[MASS]))[self._moved_by_ground]
            moved = moved.expand(*u.shape[:-1], -1)
            terms.append((moved, torch.zeros_like(moved)))
        if self.smooth.stop > self.smooth.start:
            smooth = torch.ones_like(jet.value[..., self.smooth])
            terms.append((smooth, 2.0 / self.inputs.edge * smooth))
        if self.loaded:
            pushed = torch.as_tensor(-self._pushed.data).to(u).expand(*u.shape[:-1], -1)
            terms.append((pushed, torch.zeros_like(pushed)))
        if self.inputs.unmeasured:
            ones = torch.ones_like(jet.value[..., self.forces])
            terms.append((ones, self.inputs.correlation_time * ones))
        stiffness, damping = (torch.cat(of_terms, -1) for of_terms in zip(*terms, strict=True))
        return Linearisation(linear.force, stiffness, damping, by_parameter)

    def _linearised_memory(
        self, u: Tensor, v: Tensor, z: Tensor, parameters: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Derivatives of -h / rate (..., h) by elongation and its rate, by the kinds of parameters, and by the states.

        By those of the same connection (..., pairs), see :attr:`_recalled`. A law is elementwise, so one reverse pass
        tells the derivatives of one state's rate in all connections.
        """
        structure, kinds = self.structure, self._remembered
        number, (row, column) = structure.state_number, self._recalled

        def rate(e: Tensor, de: Tensor, z: Tensor, *values: Tensor) -> Tensor:
            varied = {**parameters, **dict(zip(kinds, values, strict=True))}
            return -structure.hidden_rate(e, de, z, varied) / self.inputs.rate

        given = [parameters[kind].expand(*z.shape[:-1], -1) for kind in kinds]
        e, de, by = structure.elongation(u), structure.elongation(v), list[Tensor]()
        out = {"e": torch.empty_like(z), "de": torch.empty_like(z), "z": z.new_empty((*z.shape[:-1], len(row)))}
        for state in range(1 + int(number.max())):
            at, pairs = number == state, number[row] == state
            _, (by_e, by_de, by_z, *by_kind) = slopes(lambda *x, at=at: rate(*x)[..., at], e, de, z, *given)
            out["e"][..., at], out["de"][..., at] = (x[..., structure.memory[at]] for x in (by_e, by_de))
            out["z"][..., pairs] = by_z[..., column[pairs]]
            by = by or by_kind  # the first state's rate alone has parameters
        return out | dict(zip(kinds, by, strict=True))

    @cached_property
    def _is_force(self) -> np.ndarray:
        """(h,) bool: the hidden functions that are forces."""
        is_force: np.ndarray = self.structure.state_number == 0
        return is_force

    @cached_property
    def _recalled(self) -> tuple[np.ndarray, np.ndarray]:
        """(pairs,) each: a hidden function, and one of the same connection, on which its rate may depend."""
        memory = self.structure.memory
        row, column = np.nonzero(memory[:, None] == memory)
        return row, column

    @cached_property
    def _remembered(self) -> tuple[str, ...]:
        """Kinds of parameters of the laws' memory."""
        groups = [group for group in self.structure.groups if group.nonlinearity.states]
        return tuple(dict.fromkeys(kind for group in groups for kind in group.nonlinearity.parameters))

    @cached_property
    def _moved_by_ground(self) -> np.ndarray:
        return np.flatnonzero(self.structure.with_ground)

    @cached_property
    def branches(self) -> Incidence:
        """(C + h, N): how the forces of connections, and the rows of their hidden forces, enter the equations."""
        if self.is_plain:
            return self.structure.incidence
        connections = hstack([self.structure.incidence.matrix, csr_matrix((self._connections, self.size - self.ndof))])
        return Incidence(vstack([connections, self.picked(self.hidden)], format="csr"))

    def branch(self, kind: str) -> np.ndarray:
        """Of each connection that has a parameter of a kind, the branch it acts in: of its force, or its hidden one."""
        carriers, _ = self.structure.carriers[kind]
        if kind not in self._remembered:
            return carriers
        hidden = self.structure.hidden_force[carriers]
        return np.where(hidden >= 0, self._connections + hidden, carriers)

    @property
    def _connections(self) -> int:
        return self.structure.incidence.shape[0]

    @cached_property
    def coupling(self) -> Coupling:
        """Which function stands in which equation, term by term."""
        branches = self.branches.matrix
        if self.is_plain:
            return Coupling(branches, branches, together=self.inputs.together)
        connections, hidden = branches[: self._connections], branches[self._connections :]
        memory, (row, column) = self.structure.memory, self._recalled
        into = [connections, hidden[row], connections[memory[self._is_force]], hidden]
        by = [self.stretched, hidden[column], hidden[self._is_force], self.stretched[memory]]
        if self.inputs.ground:
            moved = self._moved_by_ground
            into.append(self.picked(moved))
            by.append(self.picked(np.full(len(moved), self.ground.start)))
        force, coordinate = self._pushed.nonzero()
        acting = self.picked(self.acting.start + force)
        into += [self.picked(self.smooth), self.picked(coordinate), self.picked(self.forces)]
        by += [self.picked(self.smooth), acting, self.picked(self.forces)]
        return Coupling(vstack(into, format="csr"), vstack(by, format="csr"), together=True)
