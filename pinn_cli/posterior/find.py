"""From a trained network to all that is known about its unknown parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.posterior.findings import ForcePredictive, PosteriorFindings

if TYPE_CHECKING:
    from pinn_cli.posterior.base import Posterior
    from pinn_cli.posterior.samples import PosteriorSamples
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.training.band.parameter_likelihoods import ParameterLikelihoods
    from pinn_cli.training.estimate import Estimate, RunContext

# Of the force's posterior predictive: draws of all chains, and samples of the record, so that a file of a few megabytes
# holds it. A hundred draws are enough for the 5 and 95 % quantiles; with fewer samples the force would not look smooth.
PREDICTED_DRAWS, PREDICTED_SAMPLES = 100, 2048


def find_posterior(
    posterior: Posterior, problem: Problem, estimate: Estimate, run: RunContext
) -> PosteriorFindings | None:
    """Draw from the posterior of a problem whose parameters have priors; None for any other problem.

    Raises:
        DivergenceError: See :meth:`Posterior.find`.
    """
    if not problem.priors or estimate.likelihoods is None:
        return None
    from pinn_cli.posterior.diagnostics import diagnose, verdict

    likelihoods = estimate.likelihoods
    samples = posterior.find(likelihoods.marginal, likelihoods.conditional, problem.priors, run)
    table = diagnose(samples)
    repeats = 1 if problem.record.repeats is None else problem.record.repeats.count
    predictive = force_predictive(likelihoods, samples, run.seed, repeats) if len(samples.force_dofs) else None
    return PosteriorFindings(samples, table, tuple(verdict(table, samples)), predictive)


def force_predictive(
    likelihoods: ParameterLikelihoods, samples: PosteriorSamples, seed: int, repeats: int = 1
) -> ForcePredictive:
    """Measured forces as the posterior predicts them: what the motion takes with the drawn parameters, and noise.

    Args:
        likelihoods: Of all parameters, p.
        samples: Draws of the same p, and of the noise of a single measurement.
        seed: Of the noise.
        repeats: How many measurements the record is the mean of: so much less noise has what is predicted of it.
    """
    chains, count = samples.draws.shape[:2]
    kept = min(count, max(PREDICTED_DRAWS // chains, 1))
    draws = np.unique(np.linspace(0, count - 1, kept).round().astype(int))
    every = -(-len(likelihoods.force) // PREDICTED_SAMPLES)
    times, dofs = np.arange(0, len(likelihoods.force), every), samples.force_dofs - 1
    moved = samples.draws[:, draws] - likelihoods.marginal.peak  # (chains, D, p)
    slope = likelihoods.force_by_parameter[times][:, dofs]  # (T, F, p)
    force = likelihoods.force[times][:, dofs] + np.einsum("cdp,tfp->cdtf", moved, slope)
    noise = np.random.default_rng([seed, 1]).standard_normal(force.shape)
    sigma = samples.sigma_force[:, draws] / np.sqrt(repeats)
    return ForcePredictive(draws, times, force + noise * sigma[:, :, None, :])
