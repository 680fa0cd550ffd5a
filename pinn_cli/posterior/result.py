"""All that is known about the unknown parameters of a trained network once they have been sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.posterior.diagnostics import diagnose, verdict

if TYPE_CHECKING:
    import pandas as pd

    from pinn_cli.posterior.base import Posterior, PosteriorSamples
    from pinn_cli.scheme.joint_problem import JointProblem
    from pinn_cli.training.estimate import Estimate, RunContext
    from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihoods

# Of the force's posterior predictive: draws of all chains, and samples of the record, so that a file of a few megabytes
# holds it. A hundred draws are enough for the 5 and 95 % quantiles; with fewer samples the force would not look smooth.
PREDICTED_DRAWS, PREDICTED_SAMPLES = 100, 2048


@dataclass(frozen=True, eq=False)
class ForcePredictive:
    """Draws of the measured forces from the posterior predictive distribution, for some of the draws and the times.

    Attributes:
        draws: (D,), which draws of every chain, counted from 0.
        samples: (T,), which samples of the record, counted from 0, in equal steps.
        force: (chains, D, T, F), N, with the noise that the record has (that of the mean of repeated measurements); the
            DOFs are the posterior's ``force_dofs``.

    Raises:
        ValueError: The shape of ``force`` does not fit.
    """

    draws: np.ndarray
    samples: np.ndarray
    force: np.ndarray

    def __post_init__(self) -> None:
        if self.force.ndim != 4 or self.force.shape[1:3] != (len(self.draws), len(self.samples)):
            expected = f"(chains, {len(self.draws)}, {len(self.samples)}, dofs)"
            raise ValueError(f"the predicted force has shape {self.force.shape}; it must be {expected}")


@dataclass(frozen=True, eq=False)
class PosteriorResult:
    """A posterior, whether its sampling can be trusted, and what it predicts.

    Attributes:
        samples: The draws.
        diagnostics: One row per parameter: ``parameter``, ``mean``, ``std``, ``lower_90``, ``upper_90``, ``r_hat``,
            ``ess_bulk``, ``ess_tail``, ``mcse_mean``; NaN where there was no sampling.
        verdict: Why the quality check failed, one sentence each; none if it passed.
        predictive: Of the measured forces; None where it was not drawn.
    """

    samples: PosteriorSamples
    diagnostics: pd.DataFrame
    verdict: tuple[str, ...] = ()
    predictive: ForcePredictive | None = None


def posterior_result(
    posterior: Posterior, problem: JointProblem, estimate: Estimate, run: RunContext
) -> PosteriorResult | None:
    """Draw from the posterior of a problem whose parameters have priors; None for any other problem.

    Raises:
        DivergenceError: See :meth:`Posterior.sample`.
    """
    if not problem.priors or estimate.likelihoods is None:
        return None
    likelihoods = estimate.likelihoods
    samples = posterior.sample(likelihoods.marginal, likelihoods.conditional, problem.priors, run)
    table = diagnose(samples)
    repeats = 1 if problem.first.record.repeats is None else problem.first.record.repeats.count
    predictive = force_predictive(likelihoods, samples, run.seed, repeats) if len(samples.force_dofs) else None
    return PosteriorResult(samples, table, tuple(verdict(table, samples)), predictive)


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
