"""One linearisation of all residuals, and the Gauss-Newton steps that it allows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.training.function_space.kernel import Block, Layers, kernel, linearised, pulled_back, pushed_forward
from pinn_cli.training.function_space.products import Products, sum_of
from pinn_cli.training.function_space.residuals import ResidualRows
from pinn_cli.training.function_space.system import System
from pinn_cli.training.learned_parameters import LearnedParameters
from pinn_cli.training.noise_model import NoiseModel


@dataclass(frozen=True, eq=False)
class Step:
    """Where a Gauss-Newton step leads.

    Attributes:
        weights: From the present weights to the proposed ones.
        parameters: The proposed distances of the parameters from their prescribed values, in prior deviations, (p,).
        residual: What the linearised residuals become, (M,).
        loss: What the loss would become if it were that of the linearised residuals.
        system: What was solved for it.
    """

    weights: Layers
    parameters: Tensor
    residual: Tensor
    loss: float
    system: System


class Linearisation:
    """Residuals r + J dw + J_p dx about the present weights w and parameters x, each residual over its noise.

    Args:
        network: At its present weights.
        parameters: At their present values.
        rows: Which residuals.
        noise: What they are divided by.

    Attributes:
        blocks: J.
        time: (P,), s, of the equations of motion.
        residual: r, (M,).
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
        self.time = target.physics_time
        by_parameter = rows.by_parameter(parameters.uncertain, seen, felt, values, noise)
        self.by_parameter = parameters.prior_deviation * by_parameter
        if rows.deviation is not None:
            self._add(*linearised(network, target.observation_time[:1], rows.initial)[:2])

    @cached_property
    def kernel(self) -> Tensor:
        """J J', (M, M), its lower triangle."""
        return kernel(self.blocks)

    @cached_property
    def products(self) -> Products:
        """With J and J'."""
        return Products(self.blocks)

    def _add(self, block: Block, residual: Tensor) -> None:
        """Further residuals, which no parameter has a part in."""
        self.blocks.append(block)
        self.residual = torch.cat((self.residual, residual.flatten()))
        none = self.by_parameter.new_zeros(block.size, self.by_parameter.shape[1])
        self.by_parameter = torch.cat((self.by_parameter, none))

    def step(self, system: System, to_start: Layers, parameters: Tensor, precision: float) -> Step:
        """Least squares of the linearised residuals, prior and damping.

        |r + J dw + J_p (x' - x)|^2 + precision |w + dw - w_0|^2 + damping |dw|^2 + |x'|^2

        Args:
            system: Of this linearisation; its total is precision and damping.
            to_start: w_0 - w, from the present weights to those that training began with.
            parameters: x, (p,), in prior standard deviations.
            precision: Of the weights' prior about w_0.

        Raises:
            NotNearlyLinearError: Conjugate gradients do not solve it.
        """
        total, share = system.total, precision / system.total
        target = self.residual + share * self._push(to_start) - self.by_parameter @ parameters
        multiplier = system.solved(target[:, None])[:, 0]
        pulled = self._pull(multiplier)
        weights = [
            (share * w - dw / total, share * b - db / total) for (w, b), (dw, db) in zip(to_start, pulled, strict=True)
        ]
        # The residuals of a regularised least-squares problem are its multipliers, and their product its least loss.
        return Step(weights, -(self.by_parameter.T @ multiplier), multiplier, float(target @ multiplier), system)

    def _split(self, values: Tensor) -> list[Tensor]:
        pieces = values.split([block.size for block in self.blocks])
        return [piece.view(block.rows, -1) for block, piece in zip(self.blocks, pieces, strict=True)]

    def _push(self, direction: Layers) -> Tensor:
        return torch.cat([pushed_forward(block, direction).flatten() for block in self.blocks])

    def _pull(self, values: Tensor) -> Layers:
        by_block = [pulled_back(block, piece) for block, piece in zip(self.blocks, self._split(values), strict=True)]
        return [
            (sum_of(list(w)), sum_of(list(b)))
            for w, b in (zip(*layer, strict=True) for layer in zip(*by_block, strict=True))
        ]
