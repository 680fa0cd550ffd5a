"""No validation."""

from __future__ import annotations

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import Estimate
from pinn_cli.validation.base import Setup, Validation


class NoValidation(Validation):
    """The estimate alone."""

    name = "none"
    scores_records = True

    def check(self, problem: Problem, setup: Setup) -> None:
        """Anything goes."""

    def score(self, problem: Problem, estimate: Estimate, setup: Setup) -> None:
        """Nothing to score."""
        return
