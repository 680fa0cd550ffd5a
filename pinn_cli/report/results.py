"""What a run hands to its report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pinn_cli.posterior.findings import PosteriorFindings
    from pinn_cli.record.record import Record, Truth
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.validation.base import Score


@dataclass(frozen=True, eq=False)
class Results:
    """All that a run has found.

    Attributes:
        record: What the estimator saw.
        truth: What it is scored against; NaN where unknown.
        estimate: What it found.
        baseline: What the configured baseline found; None where there is none.
        posterior: Of the parameters, where one was asked for.
        score: Of the estimate without the truth, where one was asked for.
        problem: That was solved; without it there is no verdict.
    """

    record: Record
    truth: Truth
    estimate: Estimate
    baseline: Estimate | None = None
    posterior: PosteriorFindings | None = None
    score: Score | None = None
    problem: Problem | None = None
