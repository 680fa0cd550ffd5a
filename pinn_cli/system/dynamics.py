"""All unknown functions of time of a structure and its inputs, and the one equation that each of them has to obey.

The functions are the columns of a network: the coordinates q, the hidden forces z of connections with memory, the
ground's acceleration where it is measured with noise, and forces that nobody measured. Their equations are rows of the
same number:

    m (q'' + iota a_g) + B' r(B q, B q', z) - w = f       motion, N
    (z' - h(B q, B q', z)) / rate = 0                     memory, N
    a_g'' / edge^2 + 2 a_g' / edge + a_g = white noise    the ground as a Gaussian process, m/s^2
    (w' + w / tau) / rate = white noise                   an unknown force as a Gaussian process, N

Rows of first order are divided by a rate of the record, so that all of them are forces. The ground's process is flat up
to the edge of the record's band and falls off above it: between samples it does what a band-limited signal does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_matrix, eye, hstack, vstack
from torch import Tensor

from pinn_cli.system.coupling import Coupling
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.linearisation import Linearisation
from pinn_cli.system.parameters import MASS
from pinn_cli.system.structure import Structure

GROUND = "ground_acceleration"


class Jet(NamedTuple):
    """All functions at some times and their derivatives, each (..., N)."""

    value: Tensor
    rate: Tensor
    curvature: Tensor


@dataclass(frozen=True)
class Inputs:
    """What acts on a structure beside measured forces.

    Attributes:
        ground: Whether the ground's acceleration is measured, and so a function to be found.
        absolute: Whether accelerometers feel the ground's acceleration as well.
        forces: DOFs, counted from 0, with a force that nobody measured, a Gaussian process.
        correlation_time: Of those forces, s.
        rate: Of the record, 1/s, that rows of first order are divided by.
        edge: Of the ground's band, rad/s.
    """

    ground: bool = False
    absolute: bool = True
    forces: tuple[int, ...] = ()
    correlation_time: float = 1.0
    rate: float = 1.0
    edge: float = 1.0


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Equations of a structure under its inputs, in all unknown functions of time.

    Attributes:
        structure: Whose motion it is.
        inputs: Beside the measured forces.
    """

    structure: Structure
    inputs: Inputs = field(default_factory=Inputs)

    @property
    def ndof(self) -> int:
        """n, coordinates of the structure: the first functions."""
        return self.structure.ndof

    @cached_property
    def hidden(self) -> slice:
        """The hidden forces among the functions."""
        return slice(self.ndof, self.ndof + len(self.structure.memory))

    @cached_property
    def ground(self) -> slice:
        """The ground's acceleration among the functions; empty where it is not measured."""
        return slice(self.hidden.stop, self.hidden.stop + int(self.inputs.ground))

    @cached_property
    def forces(self) -> slice:
        """The unknown forces among the functions."""
        return slice(self.ground.stop, self.ground.stop + len(self.inputs.forces))

    @property
    def size(self) -> int:
        """N, functions in all."""
        return self.forces.stop

    @property
    def is_plain(self) -> bool:
        """Whether the motion is all that is unknown."""
        return self.size == self.ndof

    @property
    def beside_motion(self) -> str:
        """What is unknown beside the motion, in words."""
        parts = {
            "a hidden force": self.hidden,
            "the ground's acceleration": self.ground,
            "an unmeasured force": self.forces,
        }
        return " and ".join(name for name, at in parts.items() if at.stop > at.start)

    @cached_property
    def has_mass(self) -> Tensor:
        """(N,) bool: the coordinates."""
        return torch.arange(self.size) < self.ndof

    def mass(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """(N,), of every function's second derivative in its own equation."""
        mass = self.padded(parameters[MASS])
        if self.inputs.ground:
            mass = mass.index_fill(0, torch.tensor(self.ground.start, device=mass.device), self.inputs.edge**-2)
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
        n, structure = self.ndof, self.structure
        if self.is_plain:
            return structure.external_force(*jet, parameters)
        u, v, z = jet.value[..., :n], jet.rate[..., :n], jet.value[..., self.hidden]
        motion = parameters[MASS] * self.inertial_acceleration(jet) + structure.restoring_force(u, v, parameters, z)
        rows = [motion]
        if z.shape[-1]:
            e, de = structure.elongation(u), structure.elongation(v)
            rows.append((jet.rate[..., self.hidden] - structure.hidden_rate(e, de, z, parameters)) / self.inputs.rate)
        if self.inputs.ground:
            value, rate, curvature = (x[..., self.ground] for x in jet)
            rows.append(curvature / self.inputs.edge**2 + 2.0 * rate / self.inputs.edge + value)
        if self.inputs.forces:
            force, at = jet.value[..., self.forces], list(self.inputs.forces)
            rows[0] = motion.index_add(-1, torch.tensor(at, device=motion.device), -force)
            rows.append((jet.rate[..., self.forces] + force / self.inputs.correlation_time) / self.inputs.rate)
        return torch.cat(rows, -1)

    def external_force(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """(..., n), N: the force on every DOF, of one that nobody measured what its function says."""
        if self.is_plain:
            return self.structure.external_force(*jet, parameters)
        force = self.residual(jet, parameters)[..., : self.ndof].clone()
        force[..., list(self.inputs.forces)] = jet.value[..., self.forces]
        return force

    def linearise(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Linearisation:
        """The equations linearised: stiffness and damping of the terms of :attr:`coupling`, each (..., T)."""
        n, structure = self.ndof, self.structure
        if self.is_plain:
            return structure.linearise(jet.value, jet.rate, parameters)
        u, v, z = jet.value[..., :n], jet.rate[..., :n], jet.value[..., self.hidden]
        own = structure.linearise(u, v, parameters)
        stiffness, damping, by_parameter = [own.stiffness], [own.damping], dict(own.by_parameter)
        if z.shape[-1]:
            memory = self._linearised_memory(u, v, z, parameters)
            one, none = torch.ones_like(z), torch.zeros_like(z)
            stiffness += [memory["z"], one, memory["e"]]
            damping += [one / self.inputs.rate, none, memory["de"]]
            by_parameter |= {kind: memory[kind] for kind in self._remembered}
        if self.inputs.ground:
            pushed = (parameters[MASS] * self._influence(parameters[MASS]))[self._moved_by_ground]
            ground = torch.ones_like(jet.value[..., self.ground])
            stiffness += [pushed.expand(*u.shape[:-1], -1), ground]
            damping += [torch.zeros_like(stiffness[-2]), 2.0 / self.inputs.edge * ground]
        if self.inputs.forces:
            force = jet.value[..., self.forces]
            one, slow = torch.ones_like(force), 1.0 / (self.inputs.correlation_time * self.inputs.rate)
            stiffness += [-one, slow * one]
            damping += [0.0 * one, one / self.inputs.rate]
        return Linearisation(own.force, torch.cat(stiffness, -1), torch.cat(damping, -1), by_parameter)

    def _linearised_memory(
        self, u: Tensor, v: Tensor, z: Tensor, parameters: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Derivatives of -h / rate (..., h) by elongation, its rate, hidden force and the kinds of parameters."""
        structure = self.structure
        e, de, hidden = (x.detach().requires_grad_() for x in (structure.elongation(u), structure.elongation(v), z))
        local = {
            kind: parameters[kind].detach().expand(*z.shape[:-1], -1).clone().requires_grad_()
            for kind in self._remembered
        }
        with torch.enable_grad():
            rate = structure.hidden_rate(e, de, hidden, {**parameters, **local})
            given = {"e": e, "de": de, "z": hidden, **local}
            slopes = torch.autograd.grad(-rate.sum() / self.inputs.rate, list(given.values()), allow_unused=True)
        out = {
            name: torch.zeros_like(x) if slope is None else slope
            for (name, x), slope in zip(given.items(), slopes, strict=True)
        }
        out["e"], out["de"] = (out[name][..., structure.memory] for name in ("e", "de"))
        return out

    @cached_property
    def _remembered(self) -> tuple[str, ...]:
        """Kinds of parameters of the laws' memory."""
        groups = [group for group in self.structure.groups if group.nonlinearity.has_memory]
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
        return Incidence(vstack([connections, self._picked(self.hidden)], format="csr"))

    def branch(self, kind: str) -> np.ndarray:
        """The branches that the members of a kind of the connections' parameters belong to."""
        members = self.structure.members[kind]
        if kind not in self._remembered:
            return members
        return self._connections + np.searchsorted(self.structure.memory, members)

    @property
    def _connections(self) -> int:
        return self.structure.incidence.shape[0]

    def _picked(self, functions: slice | np.ndarray) -> csr_matrix:
        """One row for each of some functions."""
        return csr_matrix(eye(self.size, format="csr")[functions])

    @cached_property
    def coupling(self) -> Coupling:
        """Which function stands in which equation, term by term."""
        branches = self.branches.matrix
        if self.is_plain:
            return Coupling(branches, branches)
        stretched, hidden = branches[self.structure.memory], branches[self._connections :]
        into, by = [branches, stretched, hidden], [branches, hidden, stretched]
        if self.inputs.ground:
            moved = self._moved_by_ground
            into += [self._picked(moved), self._picked(self.ground)]
            by += [self._picked(np.full(len(moved), self.ground.start)), self._picked(self.ground)]
        if self.inputs.forces:
            forces = self._picked(self.forces)
            into += [self._picked(np.array(self.inputs.forces)), forces]
            by += [forces, forces]
        return Coupling(vstack(into, format="csr"), vstack(by, format="csr"), together=True)

    def sensing(self, quantity: str) -> tuple[tuple[int, csr_matrix], ...]:
        """What sensors of a quantity feel: derivatives' orders, and weights (channels, N) of the functions."""
        if quantity == GROUND:
            return ((0, self._picked(self.ground)),)
        order = ("displacement", "velocity", "acceleration").index(quantity)
        own = (order, self._picked(slice(0, self.ndof)))
        if order < 2 or not self.inputs.ground or not self.inputs.absolute:
            return (own,)
        influence = csr_matrix(self.structure.with_ground[:, None])
        return own, (0, csr_matrix(influence @ self._picked(self.ground)))

    def feels_own(self, quantity: str) -> bool:
        """Whether every sensor of a quantity feels one coordinate alone, its own."""
        return quantity != GROUND and len(self.sensing(quantity)) == 1

    def sensed(self, quantity: str, jet: Jet) -> Tensor:
        """What noise-free sensors of a quantity on every DOF show, (..., channels)."""
        if quantity == GROUND:
            return jet.value[..., self.ground]
        order = ("displacement", "velocity", "acceleration").index(quantity)
        motion = jet[order] if self.is_plain else jet[order][..., : self.ndof]
        return motion if self.feels_own(quantity) else self.inertial_acceleration(jet)
