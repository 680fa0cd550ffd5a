"""Training by SOAP: Adam in the eigenbasis of Shampoo's preconditioner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from pinn_cli.settings.legal_values import non_negative_number, positive_number, whole_number
from pinn_cli.training.gradient.adam import FirstOrder, checked_betas
from pinn_cli.training.gradient.objective import Objective
from pinn_cli.training.gradient.optimiser import Optimiser
from pinn_cli.training.gradient.training import GradientTraining
from pinn_cli.training.gradient.warm_up import WarmUp


class Soap(GradientTraining):
    """SOAP on every collocation point at once (Vyas et al. 2025; for PINNs Wang et al. 2025, "Gradient alignment").

    Args:
        iterations, stages, physics_growth: See :class:`GradientTraining`; the iterations count those of the warm-up.
        warm_up: Iterations of Adam before, 0 for none.
        learning_rate: Step of the network's weights.
        parameter_learning_rate: Step of the uncertain parameters, relative to their prescribed values.
        betas: Decay rates of the two moments.
        weight_decay: Of the network's weights.
        precondition_every: Iterations from one eigenbasis to the next.
        weights, collocation_points, dtype, history_every: See :class:`GradientTraining`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "soap"

    def __init__(
        self,
        iterations: int = 3000,
        stages: int = 2,
        physics_growth: float = 10.0,
        warm_up: int = 0,
        learning_rate: float = 3e-3,
        parameter_learning_rate: float = 5e-4,
        betas: Sequence[float] = (0.95, 0.99),
        weight_decay: float = 0.0,
        precondition_every: int = 10,
        weights: Mapping[str, float | None] | str | None = None,
        collocation_points: int | None = 512,
        dtype: str = "float32",
        history_every: int = 50,
    ) -> None:
        super().__init__(iterations, stages, physics_growth, weights, collocation_points, dtype, history_every)
        self.warm_up = whole_number("training.warm_up", warm_up)
        self.learning_rate = positive_number("training.learning_rate", learning_rate)
        self.parameter_learning_rate = positive_number("training.parameter_learning_rate", parameter_learning_rate)
        self.betas = checked_betas(betas)
        self.weight_decay = non_negative_number("training.weight_decay", weight_decay)
        self.precondition_every = whole_number("training.precondition_every", precondition_every, least=1)

    @property
    def remedy(self) -> str:
        """See :attr:`GradientTraining.remedy`."""
        return f"try a training.learning_rate below {self.learning_rate:g}"

    def optimiser(self, objective: Objective) -> Optimiser:
        """See :meth:`GradientTraining.optimiser`."""
        # It takes as long to import as torch, and nobody else needs it.
        from pytorch_optimizer import SOAP

        groups: list[dict[str, Any]] = [{"params": list(objective.network.parameters())}]
        if objective.parameters.count:
            learned = list(objective.parameters.parameters())
            groups.append({"params": learned, "lr": self.parameter_learning_rate, "weight_decay": 0.0})
        soap = SOAP(
            groups, lr=self.learning_rate, betas=self.betas, weight_decay=self.weight_decay,
            precondition_frequency=self.precondition_every,
        )  # fmt: skip
        adam = torch.optim.Adam(groups, lr=self.learning_rate, fused=True)
        return WarmUp(FirstOrder(adam), self.warm_up, FirstOrder(soap))
