"""The linearised equation of motion, row by row in local terms: by the coordinates that a DOF is coupled with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.linearisation import Linearisation
from pinn_cli.system.parameters import MASS, ParameterVector
from pinn_cli.system.quantities import CALIBRATION_UNITS

# Numbers of the table [J | P | r] that are held at once: a whole spline of a small chain, little enough for the caches,
# and no more than that for Fourier features.
CHUNK = 2_000_000


class RowPattern:
    """Where the entries of a structure's equations of motion stand.

    A row has D slots, one for every offset from its DOF to those that are coupled with it, and F slots for every kind
    of parameter, one for every connection that pulls at the DOF. Of a chain D is 3 and F is 2.

    Args:
        dynamics: Whose equations.
        vector: Of the uncertain parameters.
        like: A tensor of the dtype and device wanted.

    Attributes:
        order: (N,), the functions in the order that the band has them in; offsets are counted in it.
        offsets: (D,), from a function to those of its slots.
        coupled: (N, D) bool, the slots that are used; the others hold zeros.
        kinds: Of the parameters in the equations.
        places: (N, kinds, F), of each parameter's slot among the members of all the vector's kinds, -1 where unused.
        count: Members of all the vector's kinds.
    """

    def __init__(self, dynamics: Dynamics, vector: ParameterVector[Tensor], like: Tensor) -> None:
        coupling = dynamics.coupling
        self.dynamics, self.vector = dynamics, vector
        self.offsets, self.coupled, self.reach = coupling.offsets, coupling.coupled, coupling.reach
        self.order, self.rank = coupling.order, coupling.rank
        self.own = self.offsets.index(0)
        # Those of sensors are in no equation of motion.
        self.kinds = tuple(kind for kind in vector.kinds if kind not in CALIBRATION_UNITS)
        self.count = vector.places
        self.places = self._places()
        beside = np.where(self.coupled, coupling.neighbours, dynamics.size)
        self._neighbours, self._touching, self._own = (
            torch.as_tensor(index, device=like.device)
            for index in (beside, coupling.touching, np.where(self.places < 0, self.count, self.places))
        )
        self._by_offset, self._sign = (torch.as_tensor(x).to(like) for x in (coupling.by_offset, self._signs()))

    def _places(self) -> np.ndarray:
        touching, kinds, n = self.dynamics.branches.touching, self.kinds, self.dynamics.ndof
        places = np.full((len(touching), len(kinds), touching.shape[1]), -1, dtype=np.int64)
        for number, kind in enumerate(kinds):
            if kind == MASS:
                places[:n, number, 0] = self.vector.first[kind] + np.arange(n)
                continue
            member = np.full(self.dynamics.branches.shape[0] + 1, -1, dtype=np.int64)
            branches = self.dynamics.branch(kind)
            member[branches] = self.vector.first[kind] + np.arange(len(branches))
            places[:, number] = member[touching]
        return places

    def _signs(self) -> np.ndarray:
        """(N, kinds, F), the weight of each parameter's branch in the row."""
        signs = np.repeat(self.dynamics.branches.sign[:, None], len(self.kinds), axis=1)
        for number, kind in enumerate(self.kinds):
            if kind == MASS:
                signs[:, number] = np.eye(1, signs.shape[2])
        return signs

    def by_coordinate(self, x: Tensor) -> Tensor:
        """Derivative of B' r by the coordinates in the slots (..., n, D), from dr/de of the connections (..., C)."""
        ends = [_with_none(x)[..., column] for column in self._touching.T]
        slots = [
            sum(end * self._by_offset[:, i, slot] for i, end in enumerate(ends)) for slot in range(len(self.offsets))
        ]
        return torch.stack([slot if isinstance(slot, Tensor) else x.new_zeros(()) for slot in slots], -1)

    def neighbours(self, x: Tensor) -> Tensor:
        """Motion of the coordinates in the slots, (..., n) to (..., n, D); what there is not does not move."""
        return _with_none(x)[..., self._neighbours]

    def by_parameter(self, own: Tensor) -> Tensor:
        """(..., n, kinds, F), rows by parameter, from what each does to its own connection or mass (..., count)."""
        return _with_none(own)[..., self._own] * self._sign

    def of_parameters(self, values: Tensor) -> Tensor:
        """(n, kinds, F), values of all members (count,) in the slots; 0 where unused."""
        return _with_none(values)[self._own]

    def uncertain_columns(self, parameter: Tensor, dof: int) -> Tensor:
        """Rows of one DOF by every uncertain parameter, (..., kinds, F) to (..., p)."""
        own = self._own[dof].flatten().to(parameter.device)
        out = parameter.new_zeros((*parameter.shape[:-2], self.count + 1))
        out[..., own] = parameter.flatten(-2)
        out[..., -1] = 0.0
        return out[..., torch.as_tensor(self.vector.column, device=parameter.device)]


@dataclass(frozen=True, eq=False)
class EquationRows:
    """Rows of m a + B' r, or of B' r alone, in the slots of a pattern.

    Attributes:
        pattern: Where the slots stand.
        stiffness, damping: Derivative by the displacements and velocities in the slots, each (I, S, n, D).
        mass: (n,), derivative by the acceleration of the row's own DOF; None without the inertia force.
        parameter: (I, S, n, kinds, F), derivative by the parameters in the slots, per prior standard deviation.
    """

    pattern: RowPattern
    stiffness: Tensor
    damping: Tensor
    mass: Tensor | None
    parameter: Tensor

    @classmethod
    def of(
        cls,
        pattern: RowPattern,
        slope: Linearisation,
        mass: Tensor | None,
        acceleration: Tensor,
        spread: dict[str, Tensor],
    ) -> EquationRows:
        """Rows from the connections' linearisation.

        Args:
            pattern: Of the structure.
            slope: Derivatives of the internal forces, (I, S, C).
            mass: (n,) or None, see above.
            acceleration: (I, S, n), what a mass parameter multiplies: the motion's, or the observer's.
            spread: Kind of every uncertain parameter to the prior standard deviations of all its members, 0 of those
                that are held fixed.
        """
        stiffness, damping = pattern.by_coordinate(slope.stiffness), pattern.by_coordinate(slope.damping)
        parameter = pattern.by_parameter(own_by_parameter(slope, acceleration, spread))
        return cls(pattern, stiffness, damping, mass, parameter)

    def applied(self, displacement: Tensor, velocity: Tensor, acceleration: Tensor) -> Tensor:
        """(I, S, n), the rows times a motion (I, S, n), parameters held."""
        beside = self.pattern.neighbours
        out = (self.stiffness * beside(displacement) + self.damping * beside(velocity)).sum(-1)
        return out if self.mass is None else out + self.mass * acceleration

    def jacobian(self, segments: Segments, dofs: slice) -> Tensor:
        """The given DOFs' rows by the features of the DOFs in their slots, slot by slot, (I, dofs, S, D B)."""
        displacement, velocity = (phi[:, None, :, None, :] for phi in (segments.displacement, segments.velocity))
        stiffness, damping = (x[:, :, dofs].movedim(2, 1)[..., None] for x in (self.stiffness, self.damping))
        out = displacement * stiffness
        out.addcmul_(velocity, damping)
        if self.mass is not None:
            out[..., self.pattern.own, :] += segments.acceleration[:, None] * self.mass[dofs, None, None]
        return out.flatten(3)


def own_by_parameter(slope: Linearisation, acceleration: Tensor, spread: dict[str, Tensor]) -> Tensor:
    """(I, S, count), what each parameter does to its own connection or mass, per prior standard deviation.

    Args:
        slope: Derivatives of the internal forces.
        acceleration: What a mass parameter multiplies.
        spread: Kind to prior standard deviations of all its members, 0 of those that are held fixed.
    """
    none = acceleration.new_zeros((*acceleration.shape[:-1], 1))  # of sensors
    by_kind = {**dict.fromkeys(CALIBRATION_UNITS, none), **slope.by_parameter, MASS: acceleration}
    blocks = [by_kind[kind] * by for kind, by in spread.items()]
    return torch.cat(blocks, -1) if blocks else acceleration.new_zeros((*acceleration.shape[:-1], 0))


def _with_none(x: Tensor) -> Tensor:
    """(..., N) with a zero behind it, in the place of what there is not."""
    return torch.cat((x, x.new_zeros((*x.shape[:-1], 1))), -1)
