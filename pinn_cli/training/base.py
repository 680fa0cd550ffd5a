"""What a training is."""

from __future__ import annotations

from abc import ABC, abstractmethod

from pinn_cli.network.base import NetworkDesign
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import Estimate, RunContext


class Training(ABC):
    """A way of making the residuals of a problem small. A new one is a file here and a file in ``conf/training``."""

    @abstractmethod
    def solve(self, problem: Problem, design: NetworkDesign, run: RunContext) -> Estimate:
        """Train a network of the given design on the problem.

        Raises:
            InputError: The network cannot be trained this way.
            DivergenceError: The loss left the finite numbers.
        """

    def gives_evidence(self, design: NetworkDesign) -> bool:
        """Whether it says how probable the record is under its model, as ``log_evidence`` of its summary."""
        return False
