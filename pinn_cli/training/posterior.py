"""Standard deviations of every state at every time, from the Hessian of the most probable solution."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.blocks import ChainRows
from pinn_cli.training.bordered import BorderedFactor
from pinn_cli.training.normal_equations import NormalEquations, Point


class Posterior:
    """Gaussian posterior of readout and parameters about a solution."""

    def __init__(self, equations: NormalEquations, point: Point, factor: BorderedFactor) -> None:
        self.equations, self.point, self.factor = equations, point, factor
        self.local = torch.as_tensor(np.maximum(equations.layout.local, 0))  # (I, n, 3 B)
        self.inside = torch.as_tensor(equations.layout.local >= 0)
        self.band = torch.as_tensor(factor.inverse_band())
        self.solved = torch.as_tensor(factor.solved_border)
        # With R R^T the parameters' covariance, parameters add |(P - J A^-1 B) R|^2 to a row's variance.
        self.root = torch.linalg.cholesky(torch.as_tensor(factor.corner_covariance))

    def states(self, segments: Segments) -> tuple[Tensor, Tensor, Tensor]:
        """Standard deviation of displacement, velocity and acceleration at the segments' times, each (N, n)."""
        features = segments.displacement.shape[-1]
        kinds = [phi.cpu() for phi in (segments.displacement, segments.velocity, segments.acceleration)]
        results: list[list[Tensor]] = [[] for _ in kinds]
        for dof in range(self.equations.layout.ndof):
            position = self.local[:, dof, features : 2 * features]
            covariance = self._window(position)
            shift = self.solved[position] @ self.root  # (I, B, p)
            for result, phi in zip(results, kinds, strict=True):
                variance = ((phi @ covariance) * phi).sum(-1) + (phi @ shift).square().sum(-1)
                result.append(variance.clamp(min=0).sqrt())
        grouped = [torch.stack(result, -1).to(segments.mask.device) for result in results]
        displacement, velocity, acceleration = (segments.scatter(std).cpu() for std in grouped)
        return displacement, velocity, acceleration

    def force(self) -> Tensor:
        """Standard deviation of the force that the estimated motion takes, at the collocation points, (N, n)."""
        e = self.equations
        rows = e.rows(e.physics, self.point)
        result = [self._force_of_dof(rows, dof) for dof in range(e.layout.ndof)]
        return e.physics.scatter(torch.stack(result, -1).to(e.physics.mask.device)).cpu()

    def force_by_parameter(self) -> Tensor:
        """Change of that force with each parameter, in prior standard deviations, the motion following: (N, n, p)."""
        e = self.equations
        rows = e.rows(e.physics, self.point)
        every = [self._by_parameter(rows, self._jacobian(rows, dof), dof) for dof in range(e.layout.ndof)]
        return e.physics.scatter(torch.stack(every, 2).to(e.physics.mask.device)).cpu()

    def _force_of_dof(self, rows: ChainRows, dof: int) -> Tensor:
        jacobian = self._jacobian(rows, dof)
        variance = ((jacobian @ self._window(self.local[:, dof])) * jacobian).sum(-1)
        by_parameter = self._by_parameter(rows, jacobian, dof)
        return (variance + (by_parameter @ self.root).square().sum(-1)).clamp(min=0).sqrt()

    def _jacobian(self, rows: ChainRows, dof: int) -> Tensor:
        """(I, S, 3 B), 0 beyond the chain's ends."""
        jacobian = rows.jacobian(self.equations.physics, slice(dof, dof + 1))[:, 0].cpu()
        return jacobian * self.inside[:, dof].to(jacobian)[:, None]

    def _by_parameter(self, rows: ChainRows, jacobian: Tensor, dof: int) -> Tensor:
        """(I, S, p)."""
        held = self.equations.uncertain_columns(rows.parameter[:, :, dof].cpu(), dof)
        return held - jacobian @ self.solved[self.local[:, dof]]

    def _window(self, position: Tensor) -> Tensor:
        """Entries (I, C, C) of the inverse's band at the given positions (I, C)."""
        row, column = position[:, :, None], position[:, None, :]
        offset = (row - column).abs().clamp(max=len(self.band) - 1)
        return self.band[offset, torch.minimum(row, column)]
