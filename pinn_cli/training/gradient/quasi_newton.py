"""What trainings that learn the curvature of the loss share: Adam first, then steps with a line search."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pinn_cli.settings.legal_values import non_negative_number, positive_number, whole_number
from pinn_cli.training.gradient.adam import AdamSteps
from pinn_cli.training.gradient.objective import Evaluation, Objective
from pinn_cli.training.gradient.optimiser import Optimiser
from pinn_cli.training.gradient.training import GradientTraining


@dataclass
class QuasiNewtonTraining(GradientTraining):
    """A quasi-Newton method on every collocation point at once; other settings as in :class:`GradientTraining`.

    Attributes:
        warm_up: Iterations of Adam before, 0 for none; ``iterations`` counts them.
        learning_rate: Of this Adam.
        tolerance: Largest entry of the gradient at which the training ends.

    Raises:
        InputError: A setting outside its range.
    """

    warm_up: int = 300
    learning_rate: float = 1e-3
    tolerance: float = 1e-12

    remedy = "try training.warm_up=300, or less of training.learning_rate"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.warm_up = whole_number("training.warm_up", self.warm_up)
        self.learning_rate = positive_number("training.learning_rate", self.learning_rate)
        self.tolerance = non_negative_number("training.tolerance", self.tolerance)

    @abstractmethod
    def quasi_newton(self, objective: Objective) -> Optimiser:
        """A fresh one for the objective's variables.

        Raises:
            InputError: The network has more weights than it can hold the curvature of.
        """

    def optimiser(self, objective: Objective) -> Optimiser:
        """See :meth:`GradientTraining.optimiser`."""
        then = self.quasi_newton(objective)
        return AdamFirst(AdamSteps(objective.variables, lr=self.learning_rate), self.warm_up, then)


class AdamFirst(Optimiser):
    """Curvature is not worth learning while a random start still falls apart: first Adam, then another optimiser.

    Args:
        adam: For so many iterations.
        iterations: How many.
        then: For the rest.
    """

    def __init__(self, adam: AdamSteps, iterations: int, then: Optimiser) -> None:
        self.adam, self.iterations, self.then = adam, iterations, then
        self.done = 0

    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """See :meth:`Optimiser.step`."""
        if self.done >= self.iterations:
            return self.then.step(objective, evaluation)
        self.done += 1
        return self.adam.step(objective, evaluation)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Optimiser.state_dict`."""
        return {"done": self.done, "adam": self.adam.state_dict(), "then": self.then.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Optimiser.load_state_dict`."""
        self.done = state["done"]
        self.adam.load_state_dict(state["adam"])
        self.then.load_state_dict(state["then"])
