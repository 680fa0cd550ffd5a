"""All chains of a posterior, one after the other: those that a killed run had finished are taken over."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pinn_cli.posterior.chain_store import ChainStore, digest_of
from pinn_cli.posterior.drawn import samples_of
from pinn_cli.posterior.nuts import STATISTICS, ChainDraws, NutsSettings, sample_chain
from pinn_cli.posterior.samples import PosteriorSamples
from pinn_cli.posterior.target import Target
from pinn_cli.system.priors import Prior
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.likelihood import ParameterLikelihood

FOLDER = "chains"

log = logging.getLogger(__name__)


def sample_posterior(
    method: str,
    likelihood: ParameterLikelihood,
    priors: Sequence[Prior],
    chains: int,
    settings: NutsSettings,
    run: RunContext,
) -> PosteriorSamples:
    """Draws of a posterior by NUTS.

    Args:
        method: What the samples call it.
        likelihood: Of p parameters.
        priors: (p,), in the likelihood's order.
        chains: How many.
        settings: Of each.
        run: Its directory, where there is one, keeps every finished chain.

    Raises:
        DivergenceError: The posterior cannot be evaluated anywhere near its peak.
    """
    target = Target(likelihood, priors)
    store = _store(target, settings, run.seed, run.directory)
    found = [store.read(chain) if store else None for chain in range(1, chains + 1)]
    taken = sum(chain is not None for chain in found)
    if taken:
        log.info("%d of %d chains were finished before and are taken over", taken, chains)
    finished = _sample_missing(found, target, store, settings, run)
    x = target.unwhitened(np.stack([chain.q for chain in finished]))
    statistics = {name: np.stack([chain.statistics[name] for chain in finished]) for name in STATISTICS}
    seconds = np.array([chain.seconds for chain in finished])
    return samples_of(method, target, x, run.seed, statistics, settings.warmup, seconds)


def _store(target: Target, settings: NutsSettings, seed: int, directory: Path | None) -> ChainStore | None:
    if directory is None:
        return None
    return ChainStore(directory / FOLDER, digest_of(target, settings, seed), (settings.draws, target.size))


def _sample_missing(
    found: Sequence[ChainDraws | None],
    target: Target,
    store: ChainStore | None,
    settings: NutsSettings,
    run: RunContext,
) -> list[ChainDraws]:
    missing = sum(chain is None for chain in found)
    iterations = missing * (settings.warmup + settings.draws)
    finished = []
    with tqdm(total=iterations, disable=None if run.progress else True, unit="it", desc="nuts", leave=False) as bar:
        for number, chain in enumerate(found, start=1):
            if chain is not None:
                finished.append(chain)
                continue
            bar.set_postfix_str(f"chain {number} of {len(found)}", refresh=False)
            sampled = sample_chain(target, run.seed, number, settings, bar.update)
            if store:
                store.write(number, sampled)
            finished.append(sampled)
    return finished
