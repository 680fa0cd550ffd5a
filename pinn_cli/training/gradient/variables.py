"""The variables of an objective as one vector, with value and gradient there."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from pinn_cli.training.gradient.objective import Evaluation, Objective


class FlatVariables:
    """What moves along straight lines.

    Args:
        objective: Whose variables they are.
    """

    def __init__(self, objective: Objective) -> None:
        self.objective, self.variables = objective, objective.variables
        self.count = sum(variable.numel() for variable in self.variables)

    @property
    def vector(self) -> Tensor:
        """(count,), a copy."""
        return parameters_to_vector(self.variables).detach().clone()

    @property
    def lower(self) -> Tensor:
        """(count,), the least value that each may have: that of a bounded parameter, -inf elsewhere."""
        parameters = self.objective.parameters
        held = parameters.lower if parameters.count else parameters.lower.new_zeros(0)
        return torch.cat((held.new_full((self.count - len(held),), -math.inf), held))

    def move(self, vector: Tensor) -> Evaluation:
        """Put the variables there.

        Returns:
            The objective there, with its gradient.
        """
        self.put(vector)
        return self.with_gradient(self.objective.evaluate())

    @torch.no_grad()
    def put(self, vector: Tensor) -> None:
        """Give the variables these values, (count,)."""
        for variable, part in zip(self.variables, self.split(vector), strict=True):
            variable.copy_(part)

    def split(self, vector: Tensor) -> list[Tensor]:
        """Its parts, each shaped like its variable."""
        sizes = [variable.numel() for variable in self.variables]
        return [part.view_as(v) for part, v in zip(vector.split(sizes), self.variables, strict=True)]

    def with_gradient(self, evaluation: Evaluation) -> Evaluation:
        """The same without its graph and with its gradient, (count,)."""
        if evaluation.gradient is not None:
            return evaluation
        parts = torch.autograd.grad(evaluation.loss, self.variables, allow_unused=True, materialize_grads=True)
        terms = {name: term.detach() for name, term in evaluation.terms.items()}
        gradient = torch.cat([part.reshape(-1) for part in parts])
        return replace(evaluation, loss=evaluation.loss.detach(), terms=terms, gradient=gradient)
