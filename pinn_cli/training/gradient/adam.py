"""First-order training: the paper's algorithm 1, full-batch Adam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated, Any

import torch

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, non_negative_number, positive_number
from pinn_cli.training.gradient.losses import Evaluation, Objective
from pinn_cli.training.gradient.training import DTYPES, GradientTraining, Optimiser


@dataclass
class Adam(GradientTraining):
    """Adam on every collocation point at once, with one loss; other settings as in :class:`GradientTraining`.

    Attributes:
        learning_rate: Step of the network's weights.
        parameter_learning_rate: Step of the uncertain parameters, relative to their prescribed values.
        betas: Decay rates of Adam's two moments.
        weight_decay: Of the network's weights.
    """

    name = "adam"

    iterations: int = 2000
    stages: int = 2
    dtype: Annotated[str, tuple(DTYPES)] = "float32"
    learning_rate: float = 1e-3
    parameter_learning_rate: float = 5e-4
    betas: Sequence[float] = (0.99, 0.999)
    weight_decay: float = 1e-5

    def __post_init__(self) -> None:
        super().__post_init__()
        self.learning_rate = positive_number("training.learning_rate", self.learning_rate)
        self.parameter_learning_rate = positive_number("training.parameter_learning_rate", self.parameter_learning_rate)
        given = entries(self.betas)
        if len(given) != 2 or not all(is_finite_number(beta) and 0 <= beta < 1 for beta in given):
            allowed, hint = "two numbers from 0 to below 1", "[0.99, 0.999] in the paper"
            raise InputError("training.betas", self.betas, allowed, hint)
        self.betas = (float(given[0]), float(given[1]))
        self.weight_decay = non_negative_number("training.weight_decay", self.weight_decay)

    @property
    def remedy(self) -> str:
        """See :attr:`GradientTraining.remedy`."""
        return f"try a training.learning_rate below {self.learning_rate:g}"

    def optimiser(self, objective: Objective) -> Optimiser:
        """See :meth:`GradientTraining.optimiser`."""
        network = list(objective.network.parameters())
        groups: list[dict[str, Any]] = [{"params": network, "weight_decay": self.weight_decay}]
        if objective.parameters.count:
            # No weight decay: their prior is a term of the loss.
            groups.append({"params": list(objective.parameters.parameters()), "lr": self.parameter_learning_rate})
        first, second = self.betas
        return AdamSteps(groups, lr=self.learning_rate, betas=(first, second))


class AdamSteps(Optimiser):
    """Steps of torch.optim.Adam within bounds, which takes the given arguments."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        # Fused: a third of the time of a loop over the tensors, which small networks notice.
        self.adam = torch.optim.Adam(*arguments, **settings, fused=True)

    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """See :meth:`Optimiser.step`."""
        objective.give(objective.gradient(evaluation))
        self.adam.step()
        objective.parameters.respect_bounds()
        return ""

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Optimiser.state_dict`."""
        return self.adam.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Optimiser.load_state_dict`."""
        # torch would go on in the given tensors.
        self.adam.load_state_dict(deepcopy(dict(state)))
