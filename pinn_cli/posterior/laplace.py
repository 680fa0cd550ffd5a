"""The posterior of the parameters in closed form."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.posterior.posterior import Posterior, PosteriorSamples
from pinn_cli.posterior.target import Target
from pinn_cli.settings.legal_values import whole_number
from pinn_cli.system.priors import Prior
from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihood

if TYPE_CHECKING:
    from pinn_cli.training.estimate import RunContext


class Laplace(Posterior):
    """The Gaussian at the marginal posterior's peak, in coordinates in which positive parameters are unconstrained.

    Nothing is sampled step by step: the draws are independent, and there is nothing to diagnose. Right where the
    record says much about every parameter; elsewhere compare with :class:`pinn_cli.posterior.marginal.Marginal`.

    Args:
        draws: How many.

    Raises:
        InputError: A setting outside its range.
    """

    name = "laplace"

    def __init__(self, draws: int = 4000) -> None:
        self.draws = whole_number("posterior.draws", draws, least=1)

    def sample(self, likelihood: ParameterLikelihood, priors: Sequence[Prior], run: RunContext) -> PosteriorSamples:
        """See :meth:`Posterior.sample`; one chain."""
        started = time.perf_counter()
        target = Target(likelihood, priors)
        q = np.random.default_rng([run.seed, 1]).standard_normal((1, self.draws, target.size))
        seconds = np.array([time.perf_counter() - started])
        return target.samples(self.name, target.whitening.coordinates(q), run.seed, seconds)
