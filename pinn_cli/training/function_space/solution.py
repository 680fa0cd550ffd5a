"""How the steps of a training are solved: whichever way takes fewer operations, as far as it holds."""

from __future__ import annotations

import torch
from torch import Tensor

from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.training.function_space.feature_system import (
    FeatureSystem,
    NotNearlyLinearError,
    active_outputs,
    pattern_of,
)
from pinn_cli.training.function_space.kernel import Block
from pinn_cli.training.function_space.linearisation import Linearisation
from pinn_cli.training.function_space.system import PROBES, DenseSystem, System

# Iterations that conjugate gradients take, as counted on chains of 6 to 50 DOFs: of a step, and of its probes.
USUAL_ITERATIONS, USUAL_PROBE_ITERATIONS = 12, 3
# Share of the unknowns that the linear model of the units may miss for its bands to be taken.
MISSED_UNKNOWNS = 0.03


class Solution:
    """Builds the systems of a training's steps.

    Args:
        network: Trained.
        most_residuals: For which the whole matrix is to fit.

    Attributes:
        dense: Whether steps are solved by the factor of the whole matrix; None: not yet known.
    """

    def __init__(self, network: MlpNetwork, most_residuals: int) -> None:
        self.network, self.most_residuals = network, most_residuals
        self.dense: bool | None = None if follows_features(network) else True

    def system(self, linear: Linearisation, total: float, further: list[Block] | None = None) -> System:
        """That of a step, or of the posterior.

        Args:
            linear: The residuals' linearisation.
            total: Precision of the weights, damping included.
            further: Linearisations of quantities whose variance will be asked for.

        Raises:
            DivergenceError: It is singular in double precision.
        """
        if self.dense is None:
            self.dense = dense_operations(linear.blocks) < feature_operations(linear.blocks)
        if self.dense:
            return DenseSystem(linear.blocks, linear.by_parameter, total, linear.kernel)
        prior = coefficient_prior(self.network, linear.time)
        return FeatureSystem(linear.products, linear.by_parameter, total, prior, further or [])

    def settle_for_dense(self, linear: Linearisation, error: NotNearlyLinearError) -> None:
        """Solve with the whole matrix from now on.

        Raises:
            NotNearlyLinearError: The one given, where the whole matrix is too large.
        """
        if len(linear.residual) > self.most_residuals:
            raise error
        self.dense = True

    def for_bands(self, linear: Linearisation, precision: float, further: list[Block]) -> System:
        """That of the posterior, which leaves out next to none of the network's freedom where the whole matrix fits.

        Raises:
            DivergenceError: It is singular in double precision.
        """
        try:
            system = self.system(linear, precision, further)
            if not isinstance(system, FeatureSystem) or system.missed_unknowns() < MISSED_UNKNOWNS:
                return system
        except NotNearlyLinearError as error:
            self.settle_for_dense(linear, error)
        if len(linear.residual) > self.most_residuals:
            return system
        self.dense = True
        return self.system(linear, precision)


def follows_features(network: MlpNetwork) -> bool:
    """Whether outputs can follow the embedding's features, each for itself."""
    narrowest = min(weight.shape[1] for weight in network.weights[1:])
    return network.inputs.count > 1 and network.channels * network.ndof <= narrowest


@torch.no_grad()
def coefficient_prior(network: MlpNetwork, time: Tensor) -> Tensor:
    """(outputs, F): variance of the outputs' coefficients of the features under weights of unit variance.

    Args:
        network: Embedded.
        time: (P,), s, over which slopes of the hidden units are averaged.
    """
    slopes, means = network.mean_slopes(time)
    own = slopes[0].square().sum(1)
    constant = own + sum(
        slope.square().sum(1) * (1.0 + float(mean.square().sum()))
        for slope, mean in zip(slopes[1:], means[1:], strict=True)
    )
    return torch.cat((own[:, None].expand(-1, network.inputs.count), constant[:, None]), 1)


def dense_operations(blocks: list[Block]) -> float:
    """Multiplications and additions of a step with the whole matrix."""
    residuals = sum(block.size for block in blocks)
    derivatives = len(blocks[0].inputs[0])
    units = sum(sensitivity.shape[3] for sensitivity in blocks[0].sensitivity[:-1])
    return float(residuals) ** 2 * (derivatives**2 * units + residuals / 3.0 + 2.0 * PROBES)


def feature_operations(blocks: list[Block]) -> float:
    """The same of a step from the low-rank factor."""
    features, pattern = blocks[0].inputs[0].shape[2] + 1, pattern_of(blocks)
    together = sum(
        len(outputs) * (len(outputs) + 1) * block.sensitivity[-1].shape[2]
        for block in blocks
        for outputs in active_outputs(block)
    )
    weights = sum(a.shape[2] * d.shape[3] for a, d in zip(blocks[0].inputs, blocks[0].sensitivity, strict=True))
    weights += features * len(pattern.order)
    products = sum(4.0 * len(block.inputs[0]) * block.inputs[0].shape[1] * weights for block in blocks)
    columns = USUAL_ITERATIONS + USUAL_PROBE_ITERATIONS * PROBES
    each = products + 4.0 * features**2 * len(pattern.places)
    return together * features**2 + pattern.operations * features**3 + columns * each
