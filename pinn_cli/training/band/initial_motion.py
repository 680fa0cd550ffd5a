"""What a linear readout's normal equations gain where it is known how the motion begins."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.scheme.initial_motion import RESIDUAL_MOTION
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.band.beginning import TIE, Beginning
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.layout import BandLayout
from pinn_cli.training.record_scales import force_and_velocity_scale

# Prior standard deviation of an unknown force at the first sample, over the force that the record is about.
FIRST_FORCE = 3.0


class First(NamedTuple):
    """The values and rates that functions have at the first sample.

    Attributes:
        deviation: (functions, 2), standard deviations of the functions and of their derivatives about these; infinite
            where nothing is known.
        column: (functions, 2), which of the uncertain numbers each is, -1 where it is 0.
        value: (p,), of the uncertain numbers what they are where none has moved.
        unit: (p,), what one of them moves by.
    """

    deviation: np.ndarray
    column: np.ndarray
    value: np.ndarray
    unit: np.ndarray


class InitialMotion:
    """Displacement and velocity of every DOF at the first sample, and hidden forces, over standard deviations.

    Two residuals per function, linear in the readout: J w - x with J (F, 2, B) over the B features alive there; of a
    hidden force the second is 0. All of it is on the CPU, where the solver is.

    Args:
        network: Fixed features, linear readout.
        first: What they are.
        layout: Of the readout weights.
        time: (N,), s, the record's.
    """

    def __init__(self, network: LinearReadout, first: First, layout: BandLayout, time: Tensor) -> None:
        segments = network.segments(time[:1])
        alive = segments.mask[:, 0] > 0
        feature = segments.feature[alive][0].cpu().numpy()
        rows = torch.stack((segments.displacement[alive][0, 0], segments.velocity[alive][0, 0])).cpu()
        self.jacobian = rows / rows.new_tensor(first.deviation)[:, :, None]
        place = layout.positions(feature[None], np.arange(len(first.deviation))[:, None])  # (F, B)
        self.place = torch.as_tensor(place)
        row, column = np.broadcast_arrays(place[:, :, None], place[:, None, :])
        self.lower = row >= column
        self.row, self.column = row[self.lower], column[self.lower]
        self.size = layout.size
        # Of the uncertain numbers: which residual has each, where that stands, and how large it is there.
        self.of, self.rate = np.nonzero(first.column >= 0)
        self.number = first.column[self.of, self.rate]
        over = first.deviation[self.of, self.rate]
        self.value, self.unit = (rows.new_tensor(x[self.number] / over) for x in (first.value, first.unit))

    def loss(self, unknowns: Tensor, numbers: Tensor) -> float:
        """Sum of squares, with the uncertain numbers (p,)."""
        return float(self._residuals(unknowns.cpu(), numbers.cpu()).square().sum())

    def add(self, band: Diagonals, gradient: Tensor, unknowns: Tensor, numbers: Tensor) -> None:
        """Add their part to a normal matrix and to its gradient."""
        gram = (self.jacobian.mT @ self.jacobian).numpy()
        band.add(self.row, self.column, gram[self.lower])
        pull = torch.einsum("fr,frb->fb", self._residuals(unknowns, numbers), self.jacobian)
        gradient.index_add_(0, self.place.reshape(-1), pull.reshape(-1))

    def border(self, numbers: int) -> csr_matrix:
        """(size, p), of the readout weights against the uncertain numbers."""
        values = -(self.jacobian[self.of, self.rate] * self.unit[:, None]).numpy()
        row, column = self.place[self.of].numpy(), np.repeat(self.number, values.shape[1])
        return csr_matrix((values.ravel(), (row.ravel(), column)), (self.size, numbers))

    def add_numbers(self, corner: np.ndarray, slope: np.ndarray, unknowns: Tensor, numbers: Tensor) -> None:
        """Add products of the uncertain numbers (p, p), and their part of the gradient (p,)."""
        own = self._residuals(unknowns, numbers)[self.of, self.rate]
        np.add.at(corner, (self.number, self.number), self.unit.square().numpy())
        np.add.at(slope, self.number, -(self.unit * own).numpy())

    def _residuals(self, unknowns: Tensor, numbers: Tensor) -> Tensor:
        """(F, 2)."""
        out = torch.einsum("frb,fb->fr", self.jacobian, unknowns[self.place])
        if len(self.number):
            out[self.of, self.rate] -= self.value + self.unit * numbers[self.number]
        return out


def initial_motion(
    network: LinearReadout, problem: Problem, layout: BandLayout, time: Tensor, beginning: Beginning | None = None
) -> InitialMotion | None:
    """Of a problem whose motion begins at rest, at a known state or with unknown forces; None where all begins anyhow.

    A process that white noise drives begins somewhere, too: without a word on that, a force that nobody measured and
    the motion of a DOF without a sensor balance each other at the first samples, however large they are.
    """
    deviation, dynamics = problem.initial_deviation, problem.dynamics
    if deviation is None and beginning is None and not problem.inputs.forces:
        return None
    force, _ = force_and_velocity_scale(problem)
    # Of modes a coordinate moves so much less than a DOF, and so much more force acts on it.
    per_dof = 1.0 if problem.structure.shapes is None else problem.structure.shapes.scale
    every = np.full((dynamics.size, 2), np.inf)
    if deviation is not None:
        every[: dynamics.ndof] = np.array(deviation) / per_dof
        every[dynamics.hidden, 0] = RESIDUAL_MOTION * force
    every[dynamics.forces] = FIRST_FORCE * force / per_dof * np.array((1.0, problem.inputs.force_edge))
    if beginning is None:
        nothing = np.zeros(0)
        return InitialMotion(network, First(every, np.full(every.shape, -1), nothing, nothing), layout, time)
    own = beginning.of_functions(dynamics.ndof, dynamics.hidden, dynamics.size)
    every[own >= 0] = TIE * beginning.std[own[own >= 0]]
    before = beginning.parameters
    column = np.where(own >= 0, before + own, -1)
    value, unit = (np.array([getattr(p, name) for p in beginning.uncertain]) for name in ("prescribed", "prior_std"))
    return InitialMotion(network, First(every, column, value, unit), layout, time)
