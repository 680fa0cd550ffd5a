"""The posterior of the parameters with the motion integrated out."""

from __future__ import annotations

from pinn_cli.posterior.sampled import Sampled
from pinn_cli.training.likelihood import ParameterLikelihood


class Marginal(Sampled):
    """NUTS on the likelihood with the network's weights marginalised: the spread holds the states' uncertainty too.

    Settings: see :class:`pinn_cli.posterior.sampled.Sampled`.
    """

    name = "marginal"

    def likelihood(self, marginal: ParameterLikelihood, conditional: ParameterLikelihood) -> ParameterLikelihood:
        """See :meth:`Sampled.likelihood`."""
        return marginal
