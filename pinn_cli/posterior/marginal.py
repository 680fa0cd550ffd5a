"""The posterior of the parameters with the motion integrated out, by NUTS: chains are sampled one after the other."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from pinn_cli.posterior.posterior import Posterior, PosteriorSamples
from pinn_cli.posterior.target import Target
from pinn_cli.settings.legal_values import fraction, whole_number
from pinn_cli.system.priors import Prior
from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihood

if TYPE_CHECKING:
    from pinn_cli.training.estimate import RunContext

# R-hat compares the halves of every chain, each by its variance.
FEWEST_DRAWS = 4
# Each is a sampler with a state of its own.
MOST_CHAINS = 1000

log = logging.getLogger(__name__)


class Marginal(Posterior):
    """NUTS on the likelihood with the network's weights marginalised: the spread holds the states' uncertainty too.

    Pyro's, after Hoffman and Gelman (2014).

    Args:
        chains: Independent chains; two and more let R-hat tell whether they agree.
        warmup: Iterations of each chain in which the step size is learned; they are thrown away.
        draws: Iterations of each chain that are kept.
        target_accept: Acceptance rate that the step size is learned for; higher is slower and more careful.

    Raises:
        InputError: A setting outside its range.
    """

    name = "marginal"

    def __init__(self, chains: int = 4, warmup: int = 1000, draws: int = 1000, target_accept: float = 0.8) -> None:
        self.chains = whole_number("posterior.chains", chains, least=1, most=MOST_CHAINS)
        self.warmup = whole_number("posterior.warmup", warmup, least=1)
        self.draws = whole_number("posterior.draws", draws, least=FEWEST_DRAWS)
        self.target_accept = fraction("posterior.target_accept", target_accept, "0.8 is usual")

    def sample(self, likelihood: ParameterLikelihood, priors: Sequence[Prior], run: RunContext) -> PosteriorSamples:
        """See :meth:`Posterior.sample`. The run's directory, where there is one, keeps every finished chain."""
        # Pyro takes a third of a second to import, which a run that samples nothing need not wait for.
        from pinn_cli.posterior.nuts import STATISTICS, ChainStore, NutsSettings, sample_chain

        target = Target(likelihood, priors)
        settings = NutsSettings(self.warmup, self.draws, self.target_accept)
        numbers = range(1, self.chains + 1)
        store = None if run.directory is None else ChainStore.of(run.directory, target, settings, run.seed)
        # Those that a killed run had finished are taken over.
        by_number = {number: chain for number in numbers if store and (chain := store.read(number))}
        if by_number:
            log.info("%d of %d chains were finished before and are taken over", len(by_number), self.chains)
        iterations = (self.chains - len(by_number)) * (self.warmup + self.draws)
        with tqdm(total=iterations, disable=None if run.progress else True, unit="it", desc="nuts", leave=False) as bar:
            for number in numbers:
                if number not in by_number:
                    bar.set_postfix_str(f"chain {number} of {self.chains}", refresh=False)
                    by_number[number] = sample_chain(target, run.seed, number, settings, bar.update)
                    if store:
                        store.write(number, by_number[number])
        chains = [by_number[number] for number in numbers]
        statistics = {name: np.stack([chain.statistics[name] for chain in chains]) for name in STATISTICS}
        x = target.whitening.coordinates(np.stack([chain.q for chain in chains]))
        seconds = np.array([chain.seconds for chain in chains])
        return target.samples(self.name, x, run.seed, seconds, statistics, self.warmup)
