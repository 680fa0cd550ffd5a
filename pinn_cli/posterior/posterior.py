"""What a way of finding a posterior is, what comes of it, and whether its draws can be trusted.

Limits of R-hat and effective sample sizes as in Vehtari, Gelman, Simpson, Carpenter and Bürkner, Rank-normalization,
folding, and localization: an improved R-hat, Bayesian Analysis 16 (2021).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from pinn_cli.system.priors import Prior
from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihood
from pinn_cli.training.reported.parameter_posterior import CENTRAL_90

if TYPE_CHECKING:
    from pinn_cli.scheme.joint_problem import JointProblem
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.training.estimate import Estimate, RunContext
    from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihoods

R_HAT, EFFECTIVE_DRAWS = 1.01, 400
# Of the force's posterior predictive: draws of all chains, and samples of the record, so that a file of a few megabytes
# holds it. A hundred draws are enough for the 5 and 95 % quantiles; with fewer samples the force would not look smooth.
PREDICTED_DRAWS, PREDICTED_SAMPLES = 100, 2048


@dataclass(frozen=True, eq=False)
class PosteriorSamples:
    """Draws from the posterior and the prior, and how they came about.

    Attributes:
        method: ``marginal``, ``conditional`` or ``laplace``.
        names: The p parameters, ``c_1``, ``k_2``, ...
        draws: (chains, draws, p), SI units.
        sigma_force: (chains, draws, F), N, noise of the F measured forces.
        force_dofs: (F,), DOFs of those, counted from 1.
        prior: (draws, p).
        statistics: ArviZ's names of sample statistics (``lp``, ``step_size``, ``n_steps``, ``tree_depth``,
            ``diverging``) to (chains, draws); empty where nothing was sampled step by step (``laplace``).
        warmup: Iterations before the first draw kept, of each chain.
        seconds: (chains,), of sampling.
    """

    method: str
    names: tuple[str, ...]
    draws: np.ndarray
    sigma_force: np.ndarray
    force_dofs: np.ndarray
    prior: np.ndarray
    statistics: dict[str, np.ndarray]
    warmup: int
    seconds: np.ndarray

    @property
    def pooled(self) -> np.ndarray:
        """(chains x draws, p), all chains together."""
        return self.draws.reshape(-1, len(self.names))


class Posterior(ABC):
    """From likelihoods and priors to draws. A new one is a file here and a file in ``conf/posterior``.

    Attributes:
        name: What tables and files call it.
    """

    name: ClassVar[str]

    def check(self, problem: Problem) -> None:  # noqa: B027 - most can draw from any
        """Refuse a problem of one record that it has no likelihood for.

        Raises:
            InputError: It is such.
        """

    def likelihood(self, likelihoods: ParameterLikelihoods) -> ParameterLikelihood:
        """That it draws from: with the network's weights integrated out."""
        return likelihoods.marginal

    @abstractmethod
    def sample(self, likelihood: ParameterLikelihood, priors: Sequence[Prior], run: RunContext) -> PosteriorSamples:
        """Draws of the parameters, whose priors are in the order of the likelihood, and of the force's noise.

        The run says the seed, the directory and whether to draw a progress bar.

        Raises:
            DivergenceError: The posterior cannot be evaluated where the search for its peak starts.
        """


@dataclass(frozen=True, eq=False)
class ForcePredictive:
    """Draws of the measured forces from the posterior predictive distribution, for some of the draws and the times.

    Attributes:
        draws: (D,), which draws of every chain, counted from 0.
        samples: (T,), which samples of the record, counted from 0, in equal steps.
        force: (chains, D, T, F), N, with the noise that the record has (that of the mean of repeated measurements); the
            DOFs are the posterior's ``force_dofs``.
    """

    draws: np.ndarray
    samples: np.ndarray
    force: np.ndarray


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
    samples = posterior.sample(posterior.likelihood(likelihoods), problem.priors, run)
    table = diagnose(samples)
    repeats = 1 if problem.first.record.repeats is None else problem.first.record.repeats.count
    predictive = force_predictive(likelihoods, samples, run.seed, repeats) if len(samples.force_dofs) else None
    return PosteriorResult(samples, table, tuple(verdict(table, samples)), predictive)


def force_predictive(
    likelihoods: ParameterLikelihoods, samples: PosteriorSamples, seed: int, repeats: int = 1
) -> ForcePredictive:
    """Measured forces as the posterior predicts them: what the motion takes with the drawn parameters, and noise.

    The record is the mean of ``repeats`` measurements: so much less noise has what is predicted of it.
    """
    chains, count = samples.draws.shape[:2]
    kept = min(count, max(PREDICTED_DRAWS // chains, 1))
    draws = np.unique(np.linspace(0, count - 1, kept).round().astype(int))
    stride = -(-len(likelihoods.force) // PREDICTED_SAMPLES)
    times, dofs = np.arange(0, len(likelihoods.force), stride), samples.force_dofs - 1
    moved = samples.draws[:, draws] - likelihoods.marginal.peak  # (chains, D, p)
    slope = likelihoods.force_by_parameter[times][:, dofs]  # (T, F, p)
    force = likelihoods.force[times][:, dofs] + np.einsum("cdp,tfp->cdtf", moved, slope)
    noise = np.random.default_rng([seed, 1]).standard_normal(force.shape)
    sigma = samples.sigma_force[:, draws] / np.sqrt(repeats)
    return ForcePredictive(draws, times, force + noise * sigma[:, :, None, :])


def diagnose(samples: PosteriorSamples) -> pd.DataFrame:
    """One row for each parameter, then one for each measured force's noise, ``sigma_force_1``.

    Columns: ``parameter``, ``mean``, ``std``, ``lower_90``, ``upper_90`` (quantiles), all in SI units; ``r_hat``,
    ``ess_bulk``, ``ess_tail`` (effective numbers of draws), NaN where the draws are independent anyway (``laplace``);
    ``mcse_mean``, what the finite number of draws leaves uncertain about the mean.
    """
    columns = {name: samples.draws[..., i] for i, name in enumerate(samples.names)}
    columns |= {f"sigma_force_{dof}": samples.sigma_force[..., i] for i, dof in enumerate(samples.force_dofs)}
    sampled = bool(samples.statistics)
    return pd.DataFrame([{"parameter": name, **_row(draws, sampled)} for name, draws in columns.items()])


def verdict(table: pd.DataFrame, samples: PosteriorSamples) -> list[str]:
    """What is wrong with the draws, of which `diagnose` made the table, a line each, and what to do about it."""
    if not samples.statistics:
        return []
    lines = [line for row in table.to_dict("records") for line in _faults(row, samples.draws.shape[1])]
    if diverged := int(np.sum(samples.statistics.get("diverging", 0))):
        total = samples.draws.shape[0] * samples.draws.shape[1]
        lines.append(
            f"{diverged} of {total} draws diverged: NUTS cannot follow the posterior everywhere, so intervals may be "
            "wrong; raise posterior.target_accept (0.95, 0.99), or give narrower priors"
        )
    return lines


def _faults(row: dict[Any, Any], draws: int) -> Iterator[str]:
    name, r_hat = row["parameter"], row["r_hat"]
    if not math.isfinite(r_hat):
        yield f"{name} does not move: its draws are all the same or not finite; look at its prior"
        return
    if r_hat > R_HAT:
        yield (
            f"{name}: the chains disagree (R-hat {r_hat:.3f}, must be at most {R_HAT}); raise posterior.warmup and "
            f"posterior.draws (to {2 * draws}, say)"
        )
    kinds = (("ess_bulk", "its mean"), ("ess_tail", "its 90 % interval"))
    if short := [(row[kind], what) for kind, what in kinds if row[kind] < EFFECTIVE_DRAWS]:
        effective, what = min(short)
        enough = math.ceil(1.2 * draws * EFFECTIVE_DRAWS / max(effective, 1.0) / 100) * 100
        yield (
            f"{name}: only {effective:.0f} effective draws for {what} (must be at least {EFFECTIVE_DRAWS}); raise "
            f"posterior.draws to {enough}"
        )


def _row(draws: np.ndarray, sampled: bool) -> dict[str, float]:
    """Of one parameter (chains, draws)."""
    lower, upper = np.quantile(draws, CENTRAL_90)
    std = float(draws.std(ddof=1))
    row = {"mean": float(draws.mean()), "std": std, "lower_90": float(lower), "upper_90": float(upper)}
    if not sampled:
        unknown = dict.fromkeys(("r_hat", "ess_bulk", "ess_tail"), math.nan)
        return row | unknown | {"mcse_mean": std / math.sqrt(draws.size)}
    # arviz_stats takes a quarter of a second to import.
    from arviz_stats.base import array_stats

    with np.errstate(all="ignore"):
        return row | {
            "r_hat": float(array_stats.rhat(two_chains(draws))),
            "ess_bulk": float(array_stats.ess(draws, method="bulk")),
            "ess_tail": float(array_stats.ess(draws, method="tail", prob=CENTRAL_90)),
            "mcse_mean": float(array_stats.mcse(draws, method="mean")),
        }


def two_chains(draws: np.ndarray) -> np.ndarray:
    """Draws (chains, draws), a single chain as its two halves: ArviZ has no R-hat for one."""
    if len(draws) > 1:
        return draws
    half = draws.shape[1] // 2
    return draws[0, : 2 * half].reshape(2, half)
