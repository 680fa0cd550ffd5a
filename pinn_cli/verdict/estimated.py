"""The chain with its estimated parameters, and with others that they might as well be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.chain import Chain
    from pinn_cli.training.estimate import Estimate


def estimated_chain(problem: Problem, estimate: Estimate) -> Chain:
    """The prescribed chain with the estimated parameters in place."""
    return _chain(problem, {p.name: p.estimate for p in estimate.parameters})


def drawn_chain(problem: Problem, estimate: Estimate, random: np.random.Generator) -> Chain:
    """The same with every parameter off by its standard deviation at random, correlations allowed for.

    Signs are kept: a stiffness that is known to itself has no negative values.
    """
    std = np.nan_to_num([p.std for p in estimate.parameters])
    z = random.normal(size=len(std))
    if estimate.correlation is not None and len(std):
        values, vectors = np.linalg.eigh(np.nan_to_num(estimate.correlation))
        z = vectors @ (np.sqrt(np.maximum(values, 0.0)) * z)
    drawn = {}
    for p, move in zip(estimate.parameters, std * z, strict=True):
        value = p.estimate + float(move)
        drawn[p.name] = value if value * p.estimate > 0 else p.estimate
    return _chain(problem, drawn)


def _chain(problem: Problem, values: Mapping[str, float]) -> Chain:
    tensors = {kind: given.detach().cpu().double().clone() for kind, given in problem.chain.parameters.items()}
    for parameter in problem.uncertain:
        if parameter.name in values:
            tensors[parameter.kind][parameter.index] = values[parameter.name]
    return problem.chain.with_parameters(**tensors)
