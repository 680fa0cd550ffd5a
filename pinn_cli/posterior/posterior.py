"""What a way of finding a posterior is, and what comes of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pinn_cli.system.priors import Prior
from pinn_cli.training.likelihood import ParameterLikelihood

if TYPE_CHECKING:
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.training.estimate import RunContext
    from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihoods


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
        """Draws of the parameters and of the force's noise.

        Args:
            likelihood: See :meth:`likelihood`.
            priors: Of its parameters, in their order.
            run: Seed, directory and whether to draw a progress bar.

        Raises:
            DivergenceError: The posterior cannot be evaluated where the search for its peak starts.
        """
