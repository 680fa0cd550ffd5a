"""Estimates, standard deviations and intervals of the parameters, with the motion integrated out."""

from __future__ import annotations

import numpy as np

from pinn_cli.training.band.discrepancy_search import Trained
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.bounded_estimates import bounded_estimates
from pinn_cli.training.estimate import ParameterEstimate
from pinn_cli.training.truncated_gaussian import TruncatedGaussian


def parameter_posterior(equations: NormalEquations, trained: Trained) -> tuple[list[ParameterEstimate], np.ndarray]:
    """Every uncertain parameter, and the (p, p) correlation of all of them.

    The posterior is the Gaussian of the joint Hessian with the readout weights marginalised, of which parameters that
    cannot be negative leave only a part. Where a bound holds one back, the Gaussian's own peak lies beyond the bound,
    at a Newton step's distance from the solution. What misfit may have added to each comes on top. Which of them is
    the estimate: :func:`pinn_cli.training.bounded_estimates.bounded_estimates`.
    """
    mode = trained.solution.point.parameters.cpu().numpy()
    peak = mode + _newton_step(equations, trained)
    posterior = TruncatedGaussian(peak, trained.factor.corner_covariance, equations.lower)
    misfit = coherent_misfit(equations, trained)
    estimates = bounded_estimates(equations.problem.uncertain, equations.scale.cpu().numpy(), mode, posterior, misfit)
    covariance = posterior.covariance + np.diag(misfit**2)
    unit = np.sqrt(np.diag(covariance))
    return estimates, covariance / np.outer(unit, unit)


def coherent_misfit(equations: NormalEquations, trained: Trained) -> np.ndarray:
    """(p,) standard deviation, in prior ones, of what the model leaves out and each parameter may have taken in.

    The Hessian takes the discrepancy for noise, which averages out over a record. A force that was forgotten does not:
    that of a cubic spring follows the motion as that of a linear one does, and however long the record is, the linear
    one comes out stiffer. So a discrepancy of root mean square d may hide d / rms(dr/dx) of a parameter x whose force
    on its connection is r, or what the prior lets it hide. Without model error d is small, and this with it.
    """
    if not equations.vector.kinds:
        return np.zeros(0)
    per_std = equations.physics.scatter(equations.own_by_parameter(equations.physics, trained.solution.point))
    force = per_std.square().mean(0).sqrt().cpu().numpy()[equations.vector.column]
    misfit = trained.noise.misfit(equations.network.count, len(equations.problem.record.time))
    hidden = np.divide(misfit, force, out=np.zeros_like(force), where=force > 0)
    return hidden / np.hypot(1.0, hidden)


def _newton_step(equations: NormalEquations, trained: Trained) -> np.ndarray:
    """(p,) from the solution to the peak that the Gaussian would have without bounds; zero where none is active."""
    point = trained.solution.point.parameters.cpu().numpy()
    held = point <= equations.lower
    if not held.any():
        return np.zeros(len(point))
    _, step = trained.factor.step(equations.assemble(trained.solution.point, trained.noise))
    return step
