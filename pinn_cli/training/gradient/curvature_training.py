"""What trainings that learn the curvature of the loss share: Adam first, then steps with a line search."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import torch

from pinn_cli.settings.legal_values import non_negative_number, positive_number, whole_number
from pinn_cli.training.gradient.adam import FirstOrder
from pinn_cli.training.gradient.objective import Objective
from pinn_cli.training.gradient.optimiser import Optimiser
from pinn_cli.training.gradient.training import GradientTraining
from pinn_cli.training.gradient.warm_up import WarmUp


class CurvatureTraining(GradientTraining):
    """A quasi-Newton method on every collocation point at once.

    Args:
        iterations, stages, physics_growth: See :class:`GradientTraining`; the iterations count those of the warm-up.
        warm_up: Iterations of Adam before, 0 for none.
        learning_rate: Of this Adam.
        tolerance: Largest entry of the gradient at which the training ends.
        weights, collocation_points, dtype, history_every: See :class:`GradientTraining`.

    Raises:
        InputError: A setting outside its range.
    """

    remedy = "try training.warm_up=300, or less of training.learning_rate"

    def __init__(
        self,
        iterations: int,
        stages: int,
        physics_growth: float,
        warm_up: int,
        learning_rate: float,
        tolerance: float,
        weights: Mapping[str, float | None] | str | None,
        collocation_points: int | None,
        dtype: str,
        history_every: int,
    ) -> None:
        super().__init__(iterations, stages, physics_growth, weights, collocation_points, dtype, history_every)
        self.warm_up = whole_number("training.warm_up", warm_up)
        self.learning_rate = positive_number("training.learning_rate", learning_rate)
        self.tolerance = non_negative_number("training.tolerance", tolerance)

    @abstractmethod
    def quasi_newton(self, objective: Objective) -> Optimiser:
        """A fresh one for the objective's variables.

        Raises:
            InputError: The network has more weights than it can hold the curvature of.
        """

    def optimiser(self, objective: Objective) -> Optimiser:
        """See :meth:`GradientTraining.optimiser`."""
        then = self.quasi_newton(objective)
        adam = torch.optim.Adam(objective.variables, lr=self.learning_rate, fused=True)
        return WarmUp(FirstOrder(adam), self.warm_up, then)
