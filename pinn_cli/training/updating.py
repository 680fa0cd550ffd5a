"""A network that looks whether its record contradicts the earlier ones, and takes back what they said where it does.

How far prescribed parameters are off in common, as all records up to now say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import JointPrior, Problem
from pinn_cli.training.changes import found_changes, left_open, released
from pinn_cli.training.estimate import Changes, Estimate, RunContext
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.parameter_spread import updated_spread

# Rounds at most, and the relative change below which a spread has settled.
SPREAD_ROUNDS, SPREAD_SETTLED = 200, 1e-4
# Solutions at most until the changes that one finds are those that it was solved with.
SOLUTIONS = 3
# Relative change of what prescribed parameters are off in common from which on it is worth another solution.
WORTH_ANOTHER = 0.05


def common_spread(known: ParameterKnowledge) -> float:
    """The common spread that is most probable after all records; as it is where no parameter shares one."""
    sharing = known.sharing
    if not sharing.any():
        return known.spread
    assert known.prescribed is not None
    for _ in range(SPREAD_ROUNDS):
        off = ((known.mean - known.prescribed) / known.first_std)[sharing]
        variance = (np.diag(known.covariance) / known.first_std**2)[sharing]
        spread = updated_spread(off, variance, known.spread)
        if abs(spread / known.spread - 1.0) < SPREAD_SETTLED:
            break
        known = known.with_spread(spread)
    return known.spread


def under_spread(problem: Problem, spread: float) -> Problem:
    """The problem of an update whose earlier records are looked at again under another common spread."""
    assert problem.prior is not None
    uncertain = problem.uncertain
    mean, std = (np.array([getattr(p, name) for p in uncertain]) for name in ("prescribed", "prior_std"))
    known = problem.prior.known(mean, std).with_spread(spread)
    prior = JointPrior.of(known, problem.prior.levels)
    again = tuple(
        replace(p, prescribed=max(float(m), 0.0) if p.positive else float(m), prior_std=float(s))
        for p, m, s in zip(uncertain, known.mean, np.sqrt(np.diag(known.covariance)), strict=True)
    )
    structural = problem.structure.parameters
    values = {p: p.prescribed for p in again if p.kind in structural}
    return replace(problem, structure=problem.structure.with_values(values), uncertain=again, prior=prior)


@dataclass(frozen=True)
class UpdatedNetwork(TrainedNetwork):
    """A network whose problem's prior is what earlier records say."""

    def solve(self, problem: JointProblem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`; where something changed, again with it left open.

        A parameter that changed much is pulled by the others' prior as well: only a solution with it left open says by
        how much it changed, and whether another one did.
        """
        if not problem.is_informed:
            return super().solve(problem, run)
        alone, estimate = self._under_their_spread(problem.alone, run)
        solved, changes = alone, None
        for number in range(SOLUTIONS):
            estimate = estimate if number == 0 else super().solve(JointProblem.of(solved), run)
            if estimate.known is None:
                return estimate
            before, changes = changes, found_changes(alone, estimate.known, solved)
            if _names(changes) == _names(before):
                break
            solved = released(alone, changes)
        return _handing_over(replace(estimate, changes=changes), alone)

    def _under_their_spread(self, problem: Problem, run: RunContext) -> tuple[Problem, Estimate]:
        """The problem and its solution under the common spread that all records together ask for."""
        estimate = super().solve(JointProblem.of(problem), run)
        if estimate.known is None or problem.prior is None or problem.initial_state is not None:
            return problem, estimate  # a state that is handed over goes with what was handed over of the parameters
        spread = common_spread(estimate.known)
        if abs(np.log(spread / problem.prior.spread)) < WORTH_ANOTHER:
            return problem, estimate
        problem = under_spread(problem, spread)
        return problem, super().solve(JointProblem.of(problem), run)


def _handing_over(estimate: Estimate, problem: Problem) -> Estimate:
    """The same that tells a later window nothing of what changed in this one."""
    handed, changes = estimate.handed_over, estimate.changes
    if handed is None or changes is None or not changes.found:
        return estimate
    return replace(estimate, handed_over=replace(handed, known=left_open(handed.known, problem, changes)))


def _names(changes: Changes | None) -> set[str]:
    """Of the parameters that changed."""
    return set() if changes is None else {change.parameter.name for change in changes.found}
