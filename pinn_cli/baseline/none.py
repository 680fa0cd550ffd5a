"""No baseline."""

from __future__ import annotations

from pinn_cli.baseline.base import Baseline
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import RunContext


class NoBaseline(Baseline):
    """The network alone."""

    name = "none"

    def solve(self, problem: Problem, run: RunContext) -> None:
        """Nothing to compare with."""
        return
