"""What an optimiser is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from pinn_cli.training.gradient.objective import Evaluation, Objective

# Reasons to stop, for run.json.
NOTHING_LOWER = "line search found nothing lower"
GRADIENT_VANISHED = "gradient vanished"


class Optimiser(ABC):
    """Moves the variables of an objective downhill, one iteration at a time."""

    @abstractmethod
    def step(self, objective: Objective, evaluation: Evaluation) -> str:
        """One iteration.

        Args:
            objective: Its variables are moved.
            evaluation: The objective where the variables are now.

        Returns:
            Why no further iteration would help; empty where one may.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """All that the next iteration depends on but the variables, which stand at the start of it."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""
