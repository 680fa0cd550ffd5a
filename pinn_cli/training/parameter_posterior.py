"""Estimates, standard deviations and intervals of the parameters, with the motion integrated out."""

from __future__ import annotations

import numpy as np
from scipy.stats import truncnorm

from pinn_cli.training.estimate import ParameterEstimate
from pinn_cli.training.evidence import Trained
from pinn_cli.training.normal_equations import NormalEquations

# Ends of a central 90 % interval.
NINETY_PERCENT = (0.05, 0.95)


def parameter_posterior(equations: NormalEquations, trained: Trained) -> tuple[list[ParameterEstimate], np.ndarray]:
    """Every uncertain parameter, and the (p, p) correlation of all of them.

    The posterior is the Gaussian of the joint Hessian with the readout weights marginalised. That of a
    parameter that cannot be negative is cut off at zero, each by itself: where the bound holds it back, the Gaussian's
    own peak lies below zero, at a Newton step's distance.
    """
    covariance = trained.factor.corner_covariance
    point, scale = trained.solution.point.parameters.cpu().numpy(), equations.scale.cpu().numpy()
    spread = np.sqrt(np.diag(covariance))
    peak = point + _newton_step(equations, trained)
    prior = scale / np.sqrt(equations.precision(trained.noise).cpu().numpy())
    estimates = []
    for i, p in enumerate(equations.problem.uncertain):
        posterior = truncnorm((p.lower - peak[i]) / spread[i], np.inf, peak[i], spread[i])
        lower, upper = (float(p.prescribed + scale[i] * x) for x in posterior.ppf(NINETY_PERCENT))
        estimate, std = float(p.prescribed + scale[i] * point[i]), float(scale[i] * posterior.std())
        estimates.append(
            ParameterEstimate(p.name, p.prescribed, estimate, std, lower, upper, float(prior[i]), p.unknown)
        )
    return estimates, covariance / np.outer(spread, spread)


def _newton_step(equations: NormalEquations, trained: Trained) -> np.ndarray:
    """(p,) from the solution to the peak that the Gaussian would have without bounds; zero where none is active."""
    point = trained.solution.point.parameters.cpu().numpy()
    held = point <= equations.lower
    if not held.any():
        return np.zeros(len(point))
    _, step = trained.factor.step(equations.assemble(trained.solution.point, trained.noise))
    return step
