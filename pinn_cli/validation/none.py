"""No validation."""

from __future__ import annotations

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.training.estimate import Estimate
from pinn_cli.validation.validation import Setup, Validation


class NoValidation(Validation):
    """The estimate alone."""

    name = "none"
    scores_records = True

    def score(self, problem: JointProblem, estimate: Estimate, setup: Setup) -> None:
        """Nothing to score."""
        return
