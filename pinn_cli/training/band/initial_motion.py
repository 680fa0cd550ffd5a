"""What a linear readout's normal equations gain where the motion is known to begin at rest."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.scheme.initial_motion import RESIDUAL_MOTION
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.layout import BandLayout
from pinn_cli.training.record_scales import force_and_velocity_scale

# Prior standard deviation of an unknown force at the first sample, over the force that the record is about.
FIRST_FORCE = 3.0


class InitialMotion:
    """Displacement and velocity of every DOF at the first sample, and hidden forces, over prior standard deviations.

    Two residuals per function, linear in the readout: J w with J (F, 2, B) over the B features alive there; of a hidden
    force the second is 0.

    Args:
        network: Fixed features, linear readout.
        deviation: (functions, 2), prior standard deviations of the functions and of their derivatives; infinite where
            nothing is known.
        layout: Of the readout weights.
        time: (N,), s, the record's, on the device wanted.
    """

    def __init__(self, network: LinearReadout, deviation: np.ndarray, layout: BandLayout, time: Tensor) -> None:
        segments = network.segments(time[:1])
        alive = segments.mask[:, 0] > 0
        feature = segments.feature[alive][0].cpu().numpy()
        rows = torch.stack((segments.displacement[alive][0, 0], segments.velocity[alive][0, 0]))
        self.jacobian = rows / rows.new_tensor(deviation)[:, :, None]
        place = layout.positions(feature[None], np.arange(len(deviation))[:, None])  # (F, B)
        self.place = torch.as_tensor(place, device=rows.device)
        row, column = np.broadcast_arrays(place[:, :, None], place[:, None, :])
        self.lower = row >= column
        self.row, self.column = row[self.lower], column[self.lower]

    def loss(self, unknowns: Tensor) -> float:
        """Sum of squares."""
        return float(self._residuals(unknowns).square().sum())

    def add(self, band: Diagonals, gradient: Tensor, unknowns: Tensor) -> None:
        """Add their part to a normal matrix and to its gradient."""
        gram = (self.jacobian.mT @ self.jacobian).cpu().numpy()
        band.add(self.row, self.column, gram[self.lower])
        pull = torch.einsum("fr,frb->fb", self._residuals(unknowns), self.jacobian)
        gradient.index_add_(0, self.place.reshape(-1), pull.reshape(-1))

    def _residuals(self, unknowns: Tensor) -> Tensor:
        """(F, 2)."""
        return torch.einsum("frb,fb->fr", self.jacobian, unknowns[self.place])


def initial_motion(network: LinearReadout, problem: Problem, layout: BandLayout, time: Tensor) -> InitialMotion | None:
    """Of a problem whose motion begins at rest, or that has unknown forces; None where all begins anyhow.

    A process that white noise drives begins somewhere, too: without a word on that, a force that nobody measured and
    the motion of a DOF without a sensor balance each other at the first samples, however large they are.
    """
    deviation, dynamics = problem.initial_deviation, problem.dynamics
    if deviation is None and not problem.inputs.forces:
        return None
    force, _ = force_and_velocity_scale(problem)
    # Of modes a coordinate moves so much less than a DOF, and so much more force acts on it.
    per_dof = 1.0 if problem.structure.shapes is None else problem.structure.shapes.scale
    every = np.full((dynamics.size, 2), np.inf)
    if deviation is not None:
        every[: dynamics.ndof] = np.array(deviation) / per_dof
        every[dynamics.hidden, 0] = RESIDUAL_MOTION * force
    every[dynamics.forces] = FIRST_FORCE * force / per_dof * np.array((1.0, problem.inputs.force_edge))
    return InitialMotion(network, every, layout, time)
