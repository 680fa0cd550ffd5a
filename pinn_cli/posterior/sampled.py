"""What the posteriors that are found by NUTS share: their settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pinn_cli.posterior.base import Posterior, PosteriorSamples
from pinn_cli.settings.legal_values import fraction, whole_number
from pinn_cli.system.priors import Prior
from pinn_cli.training.likelihood import ParameterLikelihood

if TYPE_CHECKING:
    from pinn_cli.training.estimate import RunContext

# R-hat compares the halves of every chain, each by its variance.
FEWEST_DRAWS = 4
# Each is a sampler with a state of its own.
MOST_CHAINS = 1000


class SampledPosterior(Posterior):
    """A posterior that NUTS draws from (Hoffman and Gelman 2014; Pyro's); its name says with which likelihood.

    Args:
        chains: Independent chains; two and more let R-hat tell whether they agree.
        warmup: Iterations of each chain in which the step size is learned; they are thrown away.
        draws: Iterations of each chain that are kept.
        target_accept: Acceptance rate that the step size is learned for; higher is slower and more careful.

    Raises:
        InputError: A setting outside its range.
    """

    def __init__(self, chains: int = 4, warmup: int = 1000, draws: int = 1000, target_accept: float = 0.8) -> None:
        self.chains = whole_number("posterior.chains", chains, least=1, most=MOST_CHAINS)
        self.warmup = whole_number("posterior.warmup", warmup, least=1)
        self.draws = whole_number("posterior.draws", draws, least=FEWEST_DRAWS)
        self.target_accept = fraction("posterior.target_accept", target_accept, "0.8 is usual")

    def sample(
        self,
        marginal: ParameterLikelihood,
        conditional: ParameterLikelihood,
        priors: Sequence[Prior],
        run: RunContext,
    ) -> PosteriorSamples:
        """See :meth:`Posterior.sample`."""
        # Pyro takes a third of a second to import, which a run that samples nothing need not wait for.
        from pinn_cli.posterior.chains import sample_posterior
        from pinn_cli.posterior.nuts import NutsSettings

        likelihood = {"marginal": marginal, "conditional": conditional}[self.name]
        settings = NutsSettings(self.warmup, self.draws, self.target_accept)
        return sample_posterior(self.name, likelihood, priors, self.chains, settings, run)
