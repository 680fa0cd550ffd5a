"""Training by limited-memory BFGS."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.settings.legal_values import whole_number
from pinn_cli.training.gradient.curvature_training import CurvatureTraining
from pinn_cli.training.gradient.limited_memory import LimitedMemory
from pinn_cli.training.gradient.objective import Objective
from pinn_cli.training.gradient.optimiser import Optimiser


class Lbfgs(CurvatureTraining):
    """L-BFGS with a strong-Wolfe line search; it suits networks of any size.

    Args:
        iterations, stages, physics_growth, warm_up, learning_rate, tolerance: See :class:`CurvatureTraining`.
        memory: Steps that the curvature is learned from.
        weights, collocation_points, dtype, history_every: See :class:`GradientTraining`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "lbfgs"

    def __init__(
        self,
        iterations: int = 3000,
        stages: int = 1,
        physics_growth: float = 10.0,
        warm_up: int = 300,
        learning_rate: float = 1e-3,
        tolerance: float = 1e-12,
        memory: int = 100,
        weights: Mapping[str, float | None] | str | None = None,
        collocation_points: int | None = 512,
        dtype: str = "float64",
        history_every: int = 50,
    ) -> None:
        super().__init__(
            iterations, stages, physics_growth, warm_up, learning_rate, tolerance, weights, collocation_points, dtype,
            history_every,
        )  # fmt: skip
        self.memory = whole_number("training.memory", memory, least=1)

    def quasi_newton(self, objective: Objective) -> Optimiser:
        """See :meth:`CurvatureTraining.quasi_newton`."""
        return LimitedMemory(objective, self.memory, self.tolerance)
