"""The weighted loss as a function of a network's weights and the chain's uncertain parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.utils import parameters_to_vector

from pinn_cli.network.network import Network
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.gradient.losses import (
    EQUALISED,
    PAPER_WEIGHTS,
    PHYSICS,
    LearnedParameters,
    Losses,
    equalised_weights,
    fixed_weights,
)

# Residuals are over the largest measured value, so this loss is some million times what any start gives.
DIVERGED = 1e12


@dataclass(eq=False)
class Evaluation:
    """The loss at one point.

    Attributes:
        loss: The sum of the weighted terms, a scalar; with a graph behind it until the gradient is known.
        terms: Weighted loss terms by name.
        weights: By name of term.
        at: (variables,), where.
        known_gradient: (variables,), as one vector; None where nobody has asked for it yet.
    """

    loss: Tensor
    terms: dict[str, Tensor]
    weights: dict[str, float]
    at: Tensor
    known_gradient: Tensor | None = None


class Objective:
    """What an optimiser makes small.

    The network's weights are moved, and the uncertain parameters of the chain.

    Attributes:
        weights: By term; given as :func:`pinn_cli.training.gradient.losses.checked_weights` returns them.
        physics_factor: On the weights of the equations of motion; a training may raise it as it goes on.
    """

    def __init__(
        self,
        losses: Losses,
        network: Network,
        parameters: LearnedParameters,
        weights: Mapping[str, float | None] | str,
    ) -> None:
        self.losses, self.network, self.parameters = losses, network, parameters
        self.equalised = weights == EQUALISED
        self.weights = fixed_weights(PAPER_WEIGHTS if isinstance(weights, str) else weights)
        self.physics_factor = 1.0
        self._evaluation: Evaluation | None = None

    def begin_stage(self, stage: int, physics_factor: float) -> None:
        """Weigh the terms as the stage (counted from 0) does."""
        self.physics_factor = physics_factor
        if stage == 0 and self.equalised:
            self.weights = equalised_weights(self.losses, self.network, self.parameters)

    def term_weights(self) -> dict[str, float]:
        """Weight of every term of :meth:`Losses.terms`, those of the equations of motion times their factor."""
        return {name: w * (self.physics_factor if name in PHYSICS else 1.0) for name, w in self.weights.items()}

    @property
    def variables(self) -> list[nn.Parameter]:
        """What is moved: the network's weights, then the chain's uncertain parameters, if any."""
        return [*self.network.parameters(), *(self.parameters.parameters() if self.parameters.count else ())]

    def __call__(self) -> Evaluation:
        """The loss at the nearest point within the bounds; it need not be finite. With its gradient it is kept."""
        evaluation, at, weights = self._evaluation, self.vector, self.term_weights()
        is_known = evaluation is not None and evaluation.known_gradient is not None
        if evaluation is None or not is_known or evaluation.weights != weights or not torch.equal(evaluation.at, at):
            terms = {name: weights[name] * term for name, term in self.terms().items()}
            evaluation = self._evaluation = Evaluation(torch.stack(list(terms.values())).sum(), terms, weights, at)
        return evaluation

    def terms(self) -> dict[str, Tensor]:
        """Unweighted ones by name."""
        return self.losses.terms(self.network, self.parameters)

    def gradient(self, evaluation: Evaluation) -> Tensor:
        """(variables,), of an evaluation made where the variables are now, or asked before; its graph is let go."""
        if evaluation.known_gradient is None:
            parts = torch.autograd.grad(evaluation.loss, self.variables, allow_unused=True, materialize_grads=True)
            evaluation.loss = evaluation.loss.detach()
            evaluation.terms = {name: term.detach() for name, term in evaluation.terms.items()}
            evaluation.known_gradient = torch.cat([part.reshape(-1) for part in parts])
        return evaluation.known_gradient

    def projected_gradient(self, evaluation: Evaluation) -> Tensor:
        """That gradient, 0 where a step downhill from there would leave the bounds at once."""
        gradient = self.gradient(evaluation)
        return gradient.masked_fill((evaluation.at == self.lower) & (gradient > 0), 0.0)

    def give(self, gradient: Tensor) -> None:
        """Have an optimiser of torch find a gradient (variables,) at the variables."""
        for variable, part in zip(self.variables, self.split(gradient), strict=True):
            variable.grad = part

    @property
    def vector(self) -> Tensor:
        """(variables,), a copy."""
        return parameters_to_vector(self.variables).detach().clone()

    @property
    def lower(self) -> Tensor:
        """(variables,), the least value that each may have: that of a bounded parameter, -inf elsewhere."""
        held = self.parameters.lower if self.parameters.count else self.parameters.lower.new_zeros(0)
        count = sum(variable.numel() for variable in self.variables)
        return torch.cat((held.new_full((count - len(held),), -math.inf), held))

    @torch.no_grad()
    def put(self, vector: Tensor) -> None:
        """Give the variables these values, (variables,)."""
        for variable, part in zip(self.variables, self.split(vector), strict=True):
            variable.copy_(part)

    def split(self, vector: Tensor) -> list[Tensor]:
        """Its parts, each shaped like its variable."""
        sizes = [variable.numel() for variable in self.variables]
        return [part.view_as(v) for part, v in zip(vector.split(sizes), self.variables, strict=True)]


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
