"""One linearisation of all residuals, and the Gauss-Newton steps that it allows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.factor import cholesky
from pinn_cli.training.function_space.kernel import Block, Layers, kernel, linearised, pulled_back, pushed_forward
from pinn_cli.training.function_space.residuals import ResidualRows
from pinn_cli.training.learned_parameters import LearnedParameters
from pinn_cli.training.noise_model import NoiseModel

# Random signs that estimate how many residuals each group keeps; their scatter is a few in a thousand residuals.
PROBES = 16


@dataclass(frozen=True, eq=False)
class Step:
    """Where a Gauss-Newton step leads.

    Attributes:
        weights: From the present weights to the proposed ones.
        parameters: The proposed distances of the parameters from their prescribed values, in prior deviations, (p,).
        residual: What the linearised residuals become, (M,).
        loss: What the loss would become if it were that of the linearised residuals.
        factor: Cholesky factor of I + J J' / damping + J_p J_p', (M, M).
    """

    weights: Layers
    parameters: Tensor
    residual: Tensor
    loss: float
    factor: Tensor


class Linearisation:
    """Residuals r + J dw + J_p dx about the present weights w and parameters x, each residual over its noise.

    Args:
        network: At its present weights.
        parameters: At their present values.
        rows: Which residuals.
        noise: What they are divided by.

    Attributes:
        residual: r, (M,).
        kernel: J J', (M, M), its lower triangle.
        by_parameter: J_p, (M, p), by the parameters in prior standard deviations.
    """

    def __init__(
        self, network: MlpNetwork, parameters: LearnedParameters, rows: ResidualRows, noise: NoiseModel
    ) -> None:
        values = {name: value.detach() for name, value in parameters().items()}
        target = rows.target
        observed, first, seen = linearised(
            network, target.observation_time, lambda states: rows.observed(states, values, noise)
        )
        enforced, second, felt = linearised(
            network, target.physics_time, lambda states: rows.enforced(states, values, noise)
        )
        self.blocks: list[Block] = [observed, enforced]
        self.residual = torch.cat((first.flatten(), second.flatten()))
        deviation = parameters.prior_deviation(noise.spread)
        self.by_parameter = deviation * rows.by_parameter(parameters.uncertain, seen, felt, values, noise)
        if rows.deviation is not None:
            self._add(*linearised(network, target.observation_time[:1], rows.initial)[:2])
        self.kernel = kernel(self.blocks)

    def _add(self, block: Block, residual: Tensor) -> None:
        """Further residuals, which no parameter has a part in."""
        self.blocks.append(block)
        self.residual = torch.cat((self.residual, residual.flatten()))
        none = self.by_parameter.new_zeros(block.size, self.by_parameter.shape[1])
        self.by_parameter = torch.cat((self.by_parameter, none))

    def step(self, to_start: Layers, parameters: Tensor, precision: float, damping: float) -> Step:
        """Least squares of the linearised residuals, prior and damping.

        |r + J dw + J_p (x' - x)|^2 + precision |w + dw - w_0|^2 + damping |dw|^2 + |x'|^2

        Args:
            to_start: w_0 - w, from the present weights to those that training began with.
            parameters: x, (p,), in prior standard deviations.
            precision: Of the weights' prior about w_0.
            damping: Levenberg-Marquardt's.

        Raises:
            DivergenceError: The system is singular in double precision.
        """
        total, share = precision + damping, precision / (precision + damping)
        system = self.kernel / total
        system.addmm_(self.by_parameter, self.by_parameter.T)
        system.diagonal().add_(1.0)
        factor = cholesky(system)
        if factor is None:
            raise DivergenceError(
                "gauss_newton diverged: its normal matrix is singular; try network.width or training.collocation_points"
                " of half the size"
            )
        target = self.residual + share * self._push(to_start) - self.by_parameter @ parameters
        multiplier = torch.cholesky_solve(target[:, None], factor)[:, 0]
        pulled = self._pull(multiplier)
        weights = [
            (share * w - dw / total, share * b - db / total) for (w, b), (dw, db) in zip(to_start, pulled, strict=True)
        ]
        # The residuals of a regularised least-squares problem are its multipliers, and their product its least loss.
        return Step(weights, -(self.by_parameter.T @ multiplier), multiplier, float(target @ multiplier), factor)

    def kept(self, factor: Tensor, seed: int) -> Tensor:
        """(M,) diagonal of the inverse of a step's system: how much of each residual the fit leaves free, from 0 to 1.

        N minus the effective number of unknowns gamma of a group (MacKay 1992) is the sum over its residuals. By
        Hutchinson's probes, so single values scatter; sums over hundreds do not.
        """
        generator = torch.Generator().manual_seed(seed)
        signs = torch.randint(0, 2, (len(factor), PROBES), generator=generator).to(factor) * 2.0 - 1.0
        return (signs * torch.cholesky_solve(signs, factor)).mean(1)

    def parameter_variance(self, factor: Tensor) -> Tensor:
        """(p,), of the parameters in prior variances, weights integrated out; coarse where far below one."""
        solved = torch.cholesky_solve(self.by_parameter, factor)
        return 1.0 - (self.by_parameter * solved).sum(0)

    def _split(self, values: Tensor) -> list[Tensor]:
        pieces = values.split([block.size for block in self.blocks])
        return [piece.view(block.rows, -1) for block, piece in zip(self.blocks, pieces, strict=True)]

    def _push(self, direction: Layers) -> Tensor:
        return torch.cat([pushed_forward(block, direction).flatten() for block in self.blocks])

    def _pull(self, values: Tensor) -> Layers:
        by_block = [pulled_back(block, piece) for block, piece in zip(self.blocks, self._split(values), strict=True)]
        return [(sum_of(w), sum_of(b)) for w, b in (zip(*layer, strict=True) for layer in zip(*by_block, strict=True))]


def sum_of(tensors: tuple[Tensor, ...]) -> Tensor:
    """Their sum."""
    return torch.stack(tensors).sum(0)
