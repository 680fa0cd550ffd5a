"""Training by limited-memory BFGS after some steps of Adam: torch's, within bounds and one iteration at a time."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import torch

from pinn_cli.settings.legal_values import non_negative_number, positive_number, whole_number
from pinn_cli.training.gradient.adam import AdamSteps
from pinn_cli.training.gradient.losses import Evaluation, Objective
from pinn_cli.training.gradient.training import GradientTraining, Optimiser

# torch's L-BFGS learns no curvature below an absolute 1e-10. Losses get there; a power of two changes no digit. In
# float32 the square of a gradient must stay a number.
LOSS_UNITS = {torch.float32: 2.0**30, torch.float64: 2.0**100}
# Reasons to stop, for run.json.
NOTHING_LOWER = "line search found nothing lower"
GRADIENT_VANISHED = "gradient vanished"
# Values in one line search, and the one that is known already.
MOST_VALUES = 26


@dataclass
class Lbfgs(GradientTraining):
    """L-BFGS on every collocation point at once, with a strong-Wolfe line search; it suits networks of any size.

    Attributes:
        warm_up: Iterations of Adam before, 0 for none; ``iterations`` counts them. Curvature is not worth learning
            while a random start still falls apart.
        learning_rate: Of this Adam.
        tolerance: Largest entry of the gradient at which the training ends.
        memory: Steps that the curvature is learned from. Other settings are those of :class:`GradientTraining`.
    """

    name = "lbfgs"
    remedy = "try training.warm_up=300, or less of training.learning_rate"

    warm_up: int = 300
    learning_rate: float = 1e-3
    tolerance: float = 1e-12
    memory: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        self.warm_up = whole_number("training.warm_up", self.warm_up)
        self.learning_rate = positive_number("training.learning_rate", self.learning_rate)
        self.tolerance = non_negative_number("training.tolerance", self.tolerance)
        self.memory = whole_number("training.memory", self.memory, least=1)

    def optimiser(self, objective: Objective) -> Optimiser:
        """See :meth:`GradientTraining.optimiser`."""
        return LbfgsSteps(objective, self.memory, self.tolerance, self.warm_up, self.learning_rate)


class LbfgsSteps(Optimiser):
    """torch.optim.LBFGS with its strong-Wolfe line search.

    It sees the objective of the nearest point within the bounds, whose gradient vanishes in every direction that a
    bound blocks. Settings as of :class:`Lbfgs`.
    """

    def __init__(
        self, objective: Objective, memory: int, tolerance: float, warm_up: int = 0, learning_rate: float = 1e-3
    ) -> None:
        self.objective, self.memory, self.tolerance, self.warm_up = objective, memory, tolerance, warm_up
        self.adam = AdamSteps(objective.variables, lr=learning_rate)
        self.weights: dict[str, float] = {}
        self.unit = LOSS_UNITS[objective.variables[0].dtype]
        self.lbfgs = self._fresh()

    def _fresh(self) -> torch.optim.LBFGS:
        # Its own tolerances stop at a loss of 1e-9, where this one is still on its way.
        return torch.optim.LBFGS(
            self.objective.variables, max_iter=1, max_eval=MOST_VALUES, history_size=self.memory,
            line_search_fn="strong_wolfe", tolerance_grad=0.0, tolerance_change=0.0,
        )  # fmt: skip

    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """See :meth:`Optimiser.step`."""
        if self.warm_up > 0:
            self.warm_up -= 1
            return self.adam.step(objective, evaluation)
        if float(objective.projected_gradient(evaluation).abs().amax()) <= self.tolerance:
            return GRADIENT_VANISHED
        if evaluation.weights != self.weights:
            # Gradients of two losses say nothing about the curvature of either.
            self.lbfgs, self.weights = self._fresh(), dict(evaluation.weights)
        fresh = not self.lbfgs.state
        self.lbfgs.step(self._closure)
        objective.parameters.respect_bounds()
        if objective().loss < evaluation.loss:
            return ""
        objective.put(evaluation.at)
        self.lbfgs = self._fresh()
        return NOTHING_LOWER if fresh else ""

    def _closure(self) -> float:
        """The loss where the variables are, with their gradients."""
        evaluation = self.objective()
        self.objective.give(self.unit * self.objective.projected_gradient(evaluation))
        return self.unit * evaluation.loss.item()

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Optimiser.state_dict`."""
        return {
            "warm_up": self.warm_up,
            "adam": self.adam.state_dict(),
            "optimiser": self.lbfgs.state_dict(),
            "weights": dict(self.weights),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Optimiser.load_state_dict`."""
        self.warm_up, self.weights = state["warm_up"], dict(state["weights"])
        self.adam.load_state_dict(state["adam"])
        self.lbfgs.load_state_dict(deepcopy(state["optimiser"]))
