"""What separate outputs of displacement and velocity leave between them, d(displacement)/dt - velocity (eq. 10b)."""

from __future__ import annotations

import torch
from scipy.sparse import identity
from torch import Tensor

from pinn_cli.training.factors.constant_rows import ConstantRows
from pinn_cli.training.factors.factor import Residuals
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.point import Point


class Continuity(Residuals):
    """Of every function, at the collocation points.

    Args:
        frame: Of the record, whose network has them.
    """

    name = "continuity"

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.segments = frame.physics
        assert self.segments.continuity is not None
        self.rows = ConstantRows(
            self.segments, [(self.segments.continuity, identity(frame.dynamics.size, format="csr"))]
        )

    def residual(self, point: Point, part: slice) -> Tensor:
        """See :meth:`Residuals.residual`."""
        left = self.frame.states(self.segments, point, part).continuity
        assert left is not None
        return left

    def weight(self, noise: NoiseModel) -> Tensor:
        """See :meth:`Residuals.weight`."""
        return torch.full_like(self.frame.target.force[0], noise.continuity**-2)

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        weight = self.weight(noise)
        for part, residual in self.residuals(point):
            self.rows.add_to(sums, residual, weight, part)
