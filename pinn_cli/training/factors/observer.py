"""Accelerometers through the observer equation, (f - restoring force) / m (paper, eq. 8)."""

from __future__ import annotations

import torch
from torch import Tensor

from pinn_cli.training.factors.equation_rows import EquationRows
from pinn_cli.training.factors.factor import Residuals
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.point import Point


class Observer(Residuals):
    """What they measure against what the equation of motion says of it.

    Args:
        frame: Of the record.
        mask: (n,) bool, the DOFs whose accelerometer is compared so.
    """

    name = "observer"

    def __init__(self, frame: Frame, mask: Tensor) -> None:
        super().__init__(frame)
        self.mask, self.segments = mask, frame.observation
        gather = self.segments.gather
        self.force, self.measured = gather(frame.target.observer_force), gather(frame.target.response["acceleration"])

    def _acceleration(self, point: Point, part: slice) -> Tensor:
        jet = self.frame.jet(self.segments, point, part)
        structure = self.frame.dynamics.structure
        return structure.acceleration(jet.value, jet.rate, self.force[part], self.frame.parameters(point))

    def residual(self, point: Point, part: slice) -> Tensor:
        """See :meth:`Residuals.residual`."""
        return (self._acceleration(point, part) - self.measured[part]) * self.mask

    def weight(self, noise: NoiseModel) -> Tensor:
        """(n,): the force's noise and the discrepancy are in the residual as well."""
        mass = self.frame.prescribed["m"].cpu().numpy()
        return torch.as_tensor(noise.observation_weight(self.name, mass)).to(self.measured) * self.mask

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        # The rows of the restoring force over -m.
        frame, weight, mass = self.frame, self.weight(noise), -self.frame.parameters(point)["m"]
        for part, residual in self.residuals(point):
            slope = frame.dynamics.linearise(frame.jet(self.segments, point, part), frame.parameters(point))
            acceleration = self._acceleration(point, part)
            rows = EquationRows.of(frame.pattern, slope, None, acceleration, frame.spread)
            for each in rows.weighted(self.segments.part(part), residual * mass, weight / mass**2):
                sums.add(each)
