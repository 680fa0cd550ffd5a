"""The posterior of the parameters with the motion integrated out."""

from __future__ import annotations

from pinn_cli.posterior.sampled import SampledPosterior


class Marginal(SampledPosterior):
    """NUTS on the likelihood with the network's weights marginalised: the spread holds the states' uncertainty too.

    Settings: see :class:`pinn_cli.posterior.sampled.SampledPosterior`.
    """

    name = "marginal"
