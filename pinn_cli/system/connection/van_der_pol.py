"""Van der Pol damper."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Nonlinearity


class VanDerPol(Nonlinearity):
    """Self-exciting damper, r_n = mu (e^2 - 1) de, mu in N s/m, e in m (paper, section 2)."""

    name = "van_der_pol"
    parameters = ("mu",)
    titles: Mapping[str, str] = {"mu": "Van der Pol"}
    units: Mapping[str, str] = {"mu": "N s/m"}

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        return parameters["mu"] * (e * e - 1.0) * de
