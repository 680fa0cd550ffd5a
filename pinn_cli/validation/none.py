"""No validation."""

from __future__ import annotations

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import Estimate
from pinn_cli.validation.base import Estimator, Validation


class NoValidation(Validation):
    """The estimate alone."""

    name = "none"

    def check(self, problem: Problem, estimator: Estimator) -> None:
        """Anything goes."""

    def score(self, problem: Problem, estimate: Estimate, estimator: Estimator) -> None:
        """Nothing to score."""
        return
