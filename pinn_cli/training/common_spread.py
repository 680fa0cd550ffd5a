"""How far prescribed parameters are off in common, as all records up to now say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.scheme.problem import JointPrior, Problem
from pinn_cli.training.parameter_spread import updated_spread

# Rounds at most, and the relative change below which a spread has settled.
ROUNDS, SETTLED = 200, 1e-4


def common_spread(known: ParameterKnowledge) -> float:
    """The common spread that is most probable after all records; as it is where no parameter shares one."""
    sharing = known.sharing
    if not sharing.any():
        return known.spread
    assert known.prescribed is not None
    for _ in range(ROUNDS):
        off = ((known.mean - known.prescribed) / known.first_std)[sharing]
        variance = (np.diag(known.covariance) / known.first_std**2)[sharing]
        spread = updated_spread(off, variance, known.spread)
        if abs(spread / known.spread - 1.0) < SETTLED:
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
