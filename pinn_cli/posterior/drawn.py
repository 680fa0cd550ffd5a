"""From the coordinates that are drawn to what is reported."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.posterior.samples import PosteriorSamples
from pinn_cli.posterior.target import Target, measured_forces
from pinn_cli.system.priors import Prior


def samples_of(
    method: str,
    target: Target,
    x: np.ndarray,
    seed: int,
    statistics: dict[str, np.ndarray],
    warmup: int,
    seconds: np.ndarray,
) -> PosteriorSamples:
    """Parameters and noise at x (chains, draws, p + 1), with as many draws from the prior as of a chain."""
    return PosteriorSamples(
        method=method,
        names=target.likelihood.names,
        draws=target.parameters(x),
        sigma_force=target.sigma_force(x),
        force_dofs=measured_forces(target.likelihood) + 1,
        prior=prior_draws(target.priors, seed, x.shape[1]),
        statistics=statistics,
        warmup=warmup,
        seconds=seconds,
    )


def prior_draws(priors: Sequence[Prior], seed: int, count: int) -> np.ndarray:
    """(count, p), the same for the same seed."""
    generators = [np.random.default_rng(sequence) for sequence in np.random.SeedSequence([seed, 0]).spawn(len(priors))]
    draws = [prior.sample(generator, count) for prior, generator in zip(priors, generators, strict=True)]
    return np.stack(draws, axis=-1)
