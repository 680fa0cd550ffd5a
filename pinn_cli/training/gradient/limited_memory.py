"""Limited-memory BFGS within bounds: torch's, one iteration at a time."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import torch
from torch import Tensor

from pinn_cli.training.gradient.objective import Evaluation, Objective
from pinn_cli.training.gradient.optimiser import GRADIENT_VANISHED, NOTHING_LOWER, Optimiser
from pinn_cli.training.gradient.variables import FlatVariables

# torch's L-BFGS learns no curvature below an absolute 1e-10. Losses get there; a power of two changes no digit. In
# float32 the square of a gradient must stay a number.
UNITS = {torch.float32: 2.0**30, torch.float64: 2.0**100}
# Values in one line search, and the one that is known already.
MOST_VALUES = 26


class LimitedMemory(Optimiser):
    """torch.optim.LBFGS with its strong-Wolfe line search.

    It sees the objective of the nearest point within the bounds, whose gradient vanishes in every direction that a
    bound blocks.

    Args:
        objective: Whose variables are moved.
        memory: Steps that the curvature is learned from.
        tolerance: Largest entry of the gradient at which the training ends.
    """

    def __init__(self, objective: Objective, memory: int, tolerance: float) -> None:
        self.variables, self.memory, self.tolerance = FlatVariables(objective), memory, tolerance
        self.weights: dict[str, float] = {}
        self.unit = UNITS[objective.variables[0].dtype]
        self.optimiser = self._fresh()

    def _fresh(self) -> torch.optim.LBFGS:
        # Its own tolerances stop at a loss of 1e-9, where this one is still on its way.
        return torch.optim.LBFGS(
            self.variables.variables, max_iter=1, max_eval=MOST_VALUES, history_size=self.memory,
            line_search_fn="strong_wolfe", tolerance_grad=0.0, tolerance_change=0.0,
        )  # fmt: skip

    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """See :meth:`Optimiser.step`."""
        start, here = self.variables.vector, self.variables.with_gradient(evaluation)
        if float(self._inward(start, here).abs().amax()) <= self.tolerance:
            return GRADIENT_VANISHED
        if evaluation.weights != self.weights:
            # Gradients of two losses say nothing about the curvature of either.
            self.optimiser, self.weights = self._fresh(), dict(evaluation.weights)
        fresh = not self.optimiser.state
        seen = [(start, here)]
        self.optimiser.step(lambda: self._closure(seen))
        objective.parameters.respect_bounds()
        end = self.variables.vector
        known = [there for point, there in reversed(seen) if torch.equal(point, end)]
        if known and known[0].loss < here.loss:
            objective.remember(known[0])
            return ""
        self.variables.put(start)
        objective.remember(here)
        self.optimiser = self._fresh()
        return NOTHING_LOWER if fresh else ""

    def _closure(self, seen: list[tuple[Tensor, Evaluation]]) -> float:
        """The loss where the variables are, with their gradients; the start is known already."""
        point = self.variables.vector
        inside = torch.maximum(point, self.variables.lower)
        start, here = seen[0]
        there = here if torch.equal(point, start) else self.variables.move(inside)
        seen.append((inside, there))
        gradient = self.unit * self._inward(point, there)
        for variable, part in zip(self.variables.variables, self.variables.split(gradient), strict=True):
            variable.grad = part.clone()
        return self.unit * there.loss.item()

    def _inward(self, point: Tensor, there: Evaluation) -> Tensor:
        """The gradient, 0 where bounds block the way down."""
        assert there.gradient is not None
        lower = self.variables.lower
        return there.gradient.masked_fill((point < lower) | ((point == lower) & (there.gradient > 0)), 0.0)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Optimiser.state_dict`."""
        return {"optimiser": self.optimiser.state_dict(), "weights": dict(self.weights)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Optimiser.load_state_dict`."""
        self.weights = dict(state["weights"])
        self.optimiser.load_state_dict(deepcopy(state["optimiser"]))
