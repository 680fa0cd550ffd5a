"""A network that looks whether its record contradicts the earlier ones, and takes back what they said where it does."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.base import TrainedNetwork
from pinn_cli.training.changes import found_changes, released
from pinn_cli.training.estimate import Estimate, RunContext


@dataclass(frozen=True)
class UpdatedNetwork(TrainedNetwork):
    """A network whose problem's prior is what earlier records say."""

    def solve(self, problem: Problem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`; where something changed, once more with it left open."""
        estimate = super().solve(problem, run)
        if estimate.known is None or problem.prior is None:
            return estimate
        changes = found_changes(problem, estimate.known)
        if changes.found:
            estimate = super().solve(released(problem, changes), run)
        return replace(estimate, changes=changes)
