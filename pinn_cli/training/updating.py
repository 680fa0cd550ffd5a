"""A network that looks whether its record contradicts the earlier ones, and takes back what they said where it does."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.base import TrainedNetwork
from pinn_cli.training.changes import found_changes, released
from pinn_cli.training.estimate import Changes, Estimate, RunContext

# Solutions at most until the changes that one finds are those that it was solved with.
ROUNDS = 3


@dataclass(frozen=True)
class UpdatedNetwork(TrainedNetwork):
    """A network whose problem's prior is what earlier records say."""

    def solve(self, problem: Problem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`; where something changed, again with it left open.

        A parameter that changed much is pulled by the others' prior as well: only a solution with it left open says by
        how much it changed, and whether another one did.
        """
        solved, changes = problem, None
        for _ in range(ROUNDS):
            estimate = super().solve(solved, run)
            if estimate.known is None or problem.prior is None:
                return estimate
            before, changes = changes, found_changes(problem, estimate.known, solved)
            if _names(changes) == _names(before):
                break
            solved = released(problem, changes)
        return replace(estimate, changes=changes)


def _names(changes: Changes | None) -> set[str]:
    """Of the parameters that changed."""
    return set() if changes is None else {change.parameter.name for change in changes.found}
