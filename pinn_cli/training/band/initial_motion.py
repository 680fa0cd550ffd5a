"""What a linear readout's normal equations gain where the motion is known to begin at rest."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.band.layout import BandLayout


class InitialMotion:
    """Displacement and velocity of every DOF at the first sample, over their prior standard deviations.

    Two residuals per DOF, linear in the readout: J w with J (2, B) over the B features alive there, alike for all DOFs.

    Args:
        network: Fixed features, linear readout.
        deviation: Prior standard deviations of displacement (m) and velocity (m/s).
        layout: Of the readout weights.
        time: (N,), s, the record's, on the device wanted.
    """

    def __init__(
        self, network: LinearReadout, deviation: tuple[float, float], layout: BandLayout, time: Tensor
    ) -> None:
        segments = network.segments(time[:1])
        alive = segments.mask[:, 0] > 0
        feature = segments.feature[alive][0].cpu().numpy()
        rows = torch.stack((segments.displacement[alive][0, 0], segments.velocity[alive][0, 0]))
        self.jacobian = rows / rows.new_tensor(deviation)[:, None]
        place = layout.positions(feature[None], np.arange(layout.ndof)[:, None])  # (n, B)
        self.place = torch.as_tensor(place, device=rows.device)
        row, column = self.place[:, :, None], self.place[:, None, :]
        self.lower = (row >= column).expand(-1, *self.place.shape[1:], -1)
        self.diagonal, self.column = (row - column)[self.lower], column.expand_as(self.lower)[self.lower]

    def loss(self, unknowns: Tensor) -> float:
        """Sum of squares."""
        return float(self._residuals(unknowns).square().sum())

    def add(self, band: Tensor, gradient: Tensor, unknowns: Tensor) -> None:
        """Add their part to a normal matrix, whose lower band (half_width + 1, size) is given, and to its gradient."""
        gram = (self.jacobian.mT @ self.jacobian).expand(len(self.place), -1, -1)
        band.index_put_((self.diagonal, self.column), gram[self.lower], accumulate=True)
        pull = self._residuals(unknowns) @ self.jacobian
        gradient.index_add_(0, self.place.reshape(-1), pull.reshape(-1))

    def _residuals(self, unknowns: Tensor) -> Tensor:
        """(n, 2)."""
        return unknowns[self.place] @ self.jacobian.mT


def initial_motion(network: LinearReadout, problem: Problem, layout: BandLayout, time: Tensor) -> InitialMotion | None:
    """Of a problem whose motion begins at rest; None where it begins anyhow."""
    deviation = problem.initial_deviation
    return None if deviation is None else InitialMotion(network, deviation, layout, time)
