"""What a way of finding a posterior is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from pinn_cli.posterior.samples import PosteriorSamples
from pinn_cli.system.priors import Prior
from pinn_cli.training.likelihood import ParameterLikelihood

if TYPE_CHECKING:
    from pinn_cli.training.estimate import RunContext


class Posterior(ABC):
    """From likelihoods and priors to draws. A new one is a file here and a file in ``conf/posterior``.

    Attributes:
        name: What tables and files call it.
    """

    name: ClassVar[str]

    @abstractmethod
    def find(
        self,
        marginal: ParameterLikelihood,
        conditional: ParameterLikelihood,
        priors: Sequence[Prior],
        run: RunContext,
    ) -> PosteriorSamples:
        """Draws of the parameters and of the force's noise.

        Args:
            marginal: The likelihood with the network's weights integrated out.
            conditional: That with the network's states held as they were trained.
            priors: Of the likelihoods' parameters, in their order.
            run: Seed, directory and whether to draw a progress bar.

        Raises:
            DivergenceError: The posterior cannot be evaluated where the search for its peak starts.
        """
