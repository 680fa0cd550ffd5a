"""The unknown functions of time of a structure and its inputs: where each stands, and what sensors feel of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_matrix, eye
from torch import Tensor

from pinn_cli.system.quantities import FORCE, GROUND, MOTION, SUPPORT
from pinn_cli.system.structure import Structure

# Damping ratio of the process of second order whose spectrum is flattest below its edge (Butterworth).
FLAT = 0.5**0.5


class Jet(NamedTuple):
    """All functions at some times and their derivatives, each (..., N)."""

    value: Tensor
    rate: Tensor
    curvature: Tensor


@dataclass(frozen=True)
class Inputs:
    """What acts on a structure beside measured forces.

    Attributes:
        ground: Whether the ground's acceleration is a function to be found.
        absolute: Whether accelerometers feel the ground's acceleration as well.
        forces: DOFs, counted from 0, with a force that nobody measured, a Gaussian process.
        correlation_time: Of those forces, s.
        rate: Of the record, 1/s, that rows of first order are divided by.
        edge: Of the band of the ground's acceleration and of loads, rad/s.
        loads: DOFs, counted from 0, whose measured force is a function to be found: where the coordinates are modes, or
            a load cell is a calibrated channel.
        together: Whether sensors feel functions that no equation of motion couples.
        damping_ratio: Of the process of unknown forces: at 0.7 its spectrum is flat up to an edge; with more it falls
            off from a corner below that.
        filters: Calibrated channels, counted from 0, behind a filter that has a state, whose equation is its own.
        supports: What sensors measure of the supports that move, names of :data:`pinn_cli.system.quantities.SUPPORT`.
        misses_ground: Whether nobody measured the ground, which moves: it is a process as unknown forces are.
        left_out: Whether unknown forces stand for what the model leaves out.
    """

    ground: bool = False
    absolute: bool = True
    forces: tuple[int, ...] = ()
    correlation_time: float = 1.0
    rate: float = 1.0
    edge: float = 1.0
    loads: tuple[int, ...] = ()
    together: bool = False
    damping_ratio: float = FLAT
    filters: tuple[int, ...] = ()
    supports: tuple[str, ...] = ()
    misses_ground: bool = False
    left_out: bool = False

    @property
    def unmeasured(self) -> bool:
        """Whether something acts that nobody measured."""
        return bool(self.forces) or self.misses_ground

    @property
    def measures_ground(self) -> bool:
        """Whether the ground moves and somebody measured how."""
        return self.ground and not self.misses_ground

    @property
    def force_edge(self) -> float:
        """Where the spectrum of the unknown forces falls off, rad/s."""
        return 2.0 * self.damping_ratio / self.correlation_time


@dataclass(frozen=True, eq=False)
class Functions:
    """The columns of a network: coordinates, hidden forces, supports, ground, measured and unknown forces.

    Attributes:
        structure: Whose motion it is.
        inputs: Beside the measured forces.
    """

    structure: Structure
    inputs: Inputs = field(default_factory=Inputs)

    @property
    def ndof(self) -> int:
        """n, coordinates of the structure: the first functions."""
        return self.structure.coordinates

    @cached_property
    def hidden(self) -> slice:
        """The hidden forces among the functions."""
        return slice(self.ndof, self.ndof + len(self.structure.memory))

    @cached_property
    def supports(self) -> slice:
        """The displacements of supports that move among the functions."""
        return slice(self.hidden.stop, self.hidden.stop + self.structure.supports)

    @cached_property
    def ground(self) -> slice:
        """The ground's acceleration among the functions; empty where it is at rest."""
        if self.inputs.misses_ground:
            return slice(self.acting.stop, self.forces.stop)
        return slice(self.supports.stop, self.loads.start)

    @cached_property
    def loads(self) -> slice:
        """The measured forces among the functions."""
        start = self.supports.stop + int(self.inputs.measures_ground)
        return slice(start, start + len(self.inputs.loads))

    @cached_property
    def smooth(self) -> slice:
        """What is measured of supports, ground and forces: processes that are flat up to an edge."""
        return slice(self.supports.start, self.loads.stop)

    @cached_property
    def forces(self) -> slice:
        """What acts and nobody measured among the functions: forces, and behind them the ground's acceleration."""
        return slice(self.loads.stop, self.acting.stop + int(self.inputs.misses_ground))

    @cached_property
    def filters(self) -> slice:
        """The states of sensors' filters among the functions."""
        return slice(self.forces.stop, self.forces.stop + len(self.inputs.filters))

    @cached_property
    def acting(self) -> slice:
        """All forces among the functions."""
        return slice(self.loads.start, self.loads.stop + len(self.inputs.forces))

    @cached_property
    def loaded(self) -> list[int]:
        """The DOFs on which those act."""
        return [*self.inputs.loads, *self.inputs.forces]

    @property
    def observed(self) -> tuple[str, ...]:
        """The quantities that sensors measure of the functions."""
        ground = (GROUND,) if self.inputs.measures_ground else ()
        return (*MOTION, *ground, *self.inputs.supports, *((FORCE,) if self.inputs.loads else ()))

    @property
    def size(self) -> int:
        """N, functions in all."""
        return self.filters.stop

    @property
    def is_plain(self) -> bool:
        """Whether the motion of the DOFs is all that is unknown."""
        return self.size == self.ndof and not self.structure.is_modal

    @property
    def also_unknown(self) -> str:
        """What is unknown beside the motion, in words."""
        parts = {
            "a hidden force": self.hidden,
            "the motion of a support": self.supports,
            "the ground's acceleration": self.ground,
            "a force": self.loads,
            "an unmeasured force": slice(self.loads.stop, self.acting.stop),
            "the state of a sensor's filter": self.filters,
        }
        modes = ["the motion of modes"] if self.structure.is_modal else []
        return " and ".join(modes + [name for name, at in parts.items() if at.stop > at.start])

    def picked(self, functions: slice | np.ndarray) -> csr_matrix:
        """One row for each of some functions."""
        return csr_matrix(eye(self.size, format="csr")[functions])

    def stretching(self, x: Tensor) -> Tensor:
        """(..., n + S) of functions (..., N): those that stretch the connections, coordinates and supports."""
        coordinates = x[..., : self.ndof]
        return torch.cat((coordinates, x[..., self.supports]), -1) if self.structure.supports else coordinates

    @cached_property
    def stretched(self) -> csr_matrix:
        """(C, N), how far the functions stretch every connection."""
        return csr_matrix(self.structure.stretch.matrix @ self.picked(self.stretch_places))

    @property
    def stretch_places(self) -> np.ndarray:
        """(n + S,), where coordinates and supports stand among the functions."""
        return np.r_[0 : self.ndof, self.supports]

    def on_dofs(self, jet: Jet) -> Tensor:
        """(..., dofs), N: the forces that are functions, 0 on all other DOFs."""
        force = jet.value.new_zeros((*jet.value.shape[:-1], self.structure.ndof))
        force[..., self.loaded] = jet.value[..., self.acting]
        return force

    def sensing(self, quantity: str) -> tuple[tuple[int, csr_matrix], ...]:
        """What sensors of a quantity feel: derivatives' orders, and weights (channels, N) of the functions."""
        if quantity == GROUND:
            return ((0, self.picked(self.ground)),)
        if quantity in SUPPORT:
            return ((MOTION.index(SUPPORT[quantity]), self.picked(self.supports)),)
        structure = self.structure
        if quantity == FORCE:
            places = self.loaded, range(len(self.loaded))
            on_dofs = csr_matrix((np.ones(len(self.loaded)), places), shape=(structure.ndof, len(self.loaded)))
            return ((0, csr_matrix(on_dofs @ self.picked(self.acting))),)
        weights = csr_matrix(structure.shapes.sparse @ self.picked(slice(0, self.ndof)))
        motion = (MOTION.index(quantity), weights)
        if not self._feels_ground(quantity):
            return (motion,)
        return motion, (0, csr_matrix(csr_matrix(self.carried[:, None]) @ self.picked(self.ground)))

    @property
    def carried(self) -> np.ndarray:
        """(dofs,), how far every DOF moves with the ground."""
        assert self.structure.shapes.with_ground is not None
        return self.structure.shapes.with_ground

    def feels_coordinate(self, quantity: str) -> bool:
        """Whether every sensor of a quantity feels one coordinate alone, its own."""
        return quantity in MOTION and not self.structure.is_modal and not self._feels_ground(quantity)

    def _feels_ground(self, quantity: str) -> bool:
        """Whether sensors of a motion feel the ground's acceleration with it."""
        return quantity == MOTION[-1] and self.inputs.ground and self.inputs.absolute

    def sensed(self, quantity: str, jet: Jet) -> Tensor:
        """What noise-free sensors of a quantity on every DOF show, (..., channels)."""
        if quantity == GROUND:
            return jet.value[..., self.ground]
        if quantity in SUPPORT:
            return jet[MOTION.index(SUPPORT[quantity])][..., self.supports]
        if quantity == FORCE:
            return self.on_dofs(jet)
        motion = jet[MOTION.index(quantity)]
        if self.is_plain:
            return motion
        motion = self.structure.shapes.of_dofs(motion[..., : self.ndof])
        if not self._feels_ground(quantity):
            return motion
        return motion + jet.value[..., self.ground] * torch.as_tensor(self.carried).to(motion)
