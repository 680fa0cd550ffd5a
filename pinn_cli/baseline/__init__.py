"""Estimators beside the network, for comparison, one per file; and what one makes of a problem."""

from __future__ import annotations

import logging

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import Estimator

log = logging.getLogger(__name__)


def baseline_estimate(baseline: Estimator | None, problem: JointProblem, run: RunContext) -> Estimate | None:
    """What the baseline makes of a problem; None where there is no baseline, or it fails.

    A baseline that fails says so in the log: the network's estimate is not lost for it.
    """
    if baseline is None:
        return None
    try:
        return baseline.solve(problem, run)
    except DivergenceError as error:
        log.warning("baseline=%s: no estimate, %s", baseline.name, error)
        return None
