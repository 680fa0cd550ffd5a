"""Objectives without a network, for tests of optimisers alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import torch
from torch import Tensor, nn

from pinn_cli.training.gradient.objective import Objective
from pinn_cli.training.gradient.training import Optimiser


class PlainObjective(Objective):
    """A function of one vector, whose last entries may have lower bounds."""

    def __init__(self, function: Callable[[Tensor], Tensor], start: Tensor, lower: tuple[float, ...] = ()) -> None:
        self.function, self.x, self._known, self.physics_factor = function, nn.Parameter(start.clone()), None, 1.0
        self.weights = {"loss": 1.0}
        bounds = torch.tensor(lower, dtype=start.dtype)
        self.parameters = SimpleNamespace(count=len(lower), lower=bounds, respect_bounds=self.respect_bounds)
        self.visited: list[Tensor] = []

    def respect_bounds(self) -> None:
        with torch.no_grad():
            self.x.copy_(self.inside)

    @property
    def inside(self) -> Tensor:
        return torch.maximum(self.x, self.lower)

    @property
    def variables(self) -> list[nn.Parameter]:
        return [self.x]

    def terms(self) -> dict[str, Tensor]:
        self.visited.append(self.inside.detach().clone())
        return {"loss": self.function(self.inside)}


def minimise(optimiser: Optimiser, objective: PlainObjective, most: int) -> tuple[int, str]:
    """Iterations done and the reason to stop."""
    for iteration in range(most):
        reason = optimiser.step(objective, objective())
        if reason:
            return iteration, reason
    return most, ""


def rosenbrock(x: Tensor) -> Tensor:
    return (100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2).sum()


def quadratic(count: int, condition: float) -> tuple[Callable[[Tensor], Tensor], Tensor]:
    """A function with eigenvalues from 1 to ``condition``, and where it is least."""
    generator = torch.Generator().manual_seed(1)
    q, _ = torch.linalg.qr(torch.randn(count, count, generator=generator, dtype=torch.float64))
    matrix = q @ torch.diag(torch.logspace(0.0, math.log10(condition), count, dtype=torch.float64)) @ q.T
    bottom = torch.randn(count, generator=generator, dtype=torch.float64)
    return lambda x: 0.5 * (x - bottom) @ matrix @ (x - bottom), bottom
