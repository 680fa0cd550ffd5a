"""Some iterations of one optimiser before another takes over."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pinn_cli.training.gradient.objective import Evaluation, Objective
from pinn_cli.training.gradient.optimiser import Optimiser


class WarmUp(Optimiser):
    """Curvature is not worth learning while a random start still falls apart: first one optimiser, then another.

    Args:
        first: For so many iterations.
        iterations: How many.
        then: For the rest.
    """

    def __init__(self, first: Optimiser, iterations: int, then: Optimiser) -> None:
        self.first, self.iterations, self.then = first, iterations, then
        self.done = 0

    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """See :meth:`Optimiser.step`."""
        if self.done >= self.iterations:
            return self.then.step(objective, evaluation)
        self.done += 1
        return self.first.step(objective, evaluation)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Optimiser.state_dict`."""
        return {"done": self.done, "first": self.first.state_dict(), "then": self.then.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Optimiser.load_state_dict`."""
        self.done = state["done"]
        self.first.load_state_dict(state["first"])
        self.then.load_state_dict(state["then"])
