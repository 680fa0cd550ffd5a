"""The weighted loss as a function of a network's weights and the chain's uncertain parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pinn_cli.network.base import Network
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.gradient.learned_parameters import LearnedParameters
from pinn_cli.training.gradient.loss_weights import Weights
from pinn_cli.training.gradient.losses import Losses

# Residuals are over the largest measured value, so this loss is some million times what any start gives.
DIVERGED = 1e12


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The loss at one point.

    Attributes:
        loss: The sum of the weighted terms, a scalar with a graph behind it.
        terms: Weighted loss terms by name.
        weights: By name of term.
        gradient: (variables,), as one vector; None where nobody has asked for it yet.
    """

    loss: Tensor
    terms: dict[str, Tensor]
    weights: dict[str, float]
    gradient: Tensor | None = None


class Objective:
    """What an optimiser makes small.

    Args:
        losses: The terms.
        network: Its weights are moved.
        parameters: Of the chain; the uncertain ones are moved.
        weights: Of the terms.

    Attributes:
        physics_factor: On the weights of the equations of motion; a training may raise it as it goes on.
    """

    def __init__(self, losses: Losses, network: Network, parameters: LearnedParameters, weights: Weights) -> None:
        self.losses, self.network, self.parameters, self.weights = losses, network, parameters, weights
        self.physics_factor = 1.0
        self._known: Evaluation | None = None

    def begin_stage(self, stage: int, physics_factor: float) -> None:
        """Weigh the terms as the stage (counted from 0) does."""
        self.physics_factor = physics_factor
        self.weights.begin_stage(self.losses, self.network, self.parameters, stage)

    @property
    def variables(self) -> list[nn.Parameter]:
        """What is moved: the network's weights, then the chain's uncertain parameters, if any."""
        return [*self.network.parameters(), *(self.parameters.parameters() if self.parameters.count else ())]

    def __call__(self) -> Evaluation:
        """The loss where network and parameters are now; it need not be finite."""
        known, self._known = self._known, None
        if known is not None and known.weights == self.weights.by_term(self.physics_factor):
            return known
        return self.evaluate()

    def remember(self, evaluation: Evaluation) -> None:
        """Spare the next call its work: who has just been where the variables are left knows the loss there."""
        self._known = evaluation

    def evaluate(self) -> Evaluation:
        """The loss, worked out."""
        weights = self.weights.by_term(self.physics_factor)
        terms = {name: weights[name] * term for name, term in self.losses.terms(self.network, self.parameters).items()}
        return Evaluation(torch.stack(list(terms.values())).sum(), terms, weights)


def check_finite(evaluation: Evaluation, iteration: int, method: str, remedy: str) -> None:
    """Stop a training that has left the finite numbers.

    Raises:
        DivergenceError: It has; the message names the worst term, the iteration and what to try.
    """
    if evaluation.loss.item() < DIVERGED:  # false for NaN too
        return
    values = {name: term.item() for name, term in evaluation.terms.items()}
    worst = max(values, key=lambda name: math.inf if math.isnan(values[name]) else values[name])
    raise DivergenceError(f"{method} diverged: loss_{worst} is {values[worst]:.3g} at iteration {iteration}; {remedy}")
