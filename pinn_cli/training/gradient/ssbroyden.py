"""Training by self-scaled Broyden steps, which do best on PINNs of a few thousand weights."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number
from pinn_cli.training.gradient.curvature_training import CurvatureTraining
from pinn_cli.training.gradient.dense_quasi_newton import DenseQuasiNewton
from pinn_cli.training.gradient.objective import Objective
from pinn_cli.training.gradient.optimiser import Optimiser


class SsBroyden(CurvatureTraining):
    """Self-scaled Broyden with a strong-Wolfe line search, in float64.

    Urban, Stefanou & Pons 2025, "Unveiling the optimization process of physics informed neural networks"; Kiyani et al.
    2025, "Optimizing the optimizer for physics-informed neural networks and Kolmogorov-Arnold networks".

    Args:
        iterations, stages, physics_growth, warm_up, learning_rate, tolerance: See :class:`CurvatureTraining`.
        most_weights: Weights and uncertain parameters at most; their inverse Hessian takes 8 bytes times the square.
        weights, collocation_points, history_every: See :class:`GradientTraining`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "ssbroyden"

    def __init__(
        self,
        iterations: int = 3000,
        stages: int = 1,
        physics_growth: float = 10.0,
        warm_up: int = 300,
        learning_rate: float = 1e-3,
        tolerance: float = 1e-12,
        most_weights: int = 8000,
        weights: Mapping[str, float | None] | str | None = None,
        collocation_points: int | None = 512,
        history_every: int = 50,
    ) -> None:
        super().__init__(
            iterations, stages, physics_growth, warm_up, learning_rate, tolerance, weights, collocation_points,
            "float64", history_every,
        )  # fmt: skip
        self.most_weights = whole_number("training.most_weights", most_weights, least=1)

    def quasi_newton(self, objective: Objective) -> Optimiser:
        """See :meth:`CurvatureTraining.quasi_newton`."""
        count = sum(variable.numel() for variable in objective.variables)
        if count > self.most_weights:
            raise InputError(
                "training",
                self.name,
                f"lbfgs for a network of {count} weights",
                f"its inverse Hessian takes {8e-9 * count**2:.2g} GB; training.most_weights is {self.most_weights}, "
                "and network.width and network.depth say how many there are",
            )
        return DenseQuasiNewton(self.tolerance)
