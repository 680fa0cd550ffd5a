"""Duffing spring."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Nonlinearity


class Duffing(Nonlinearity):
    """Cubic spring, r_n = kappa e^3, kappa in N/m^3 (paper, section 2; its g_k misprints the elongation as a rate)."""

    name = "duffing"
    parameters = ("kappa",)
    titles: Mapping[str, str] = {"kappa": "Duffing"}
    units: Mapping[str, str] = {"kappa": "N/m^3"}

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        # Products, not a power: numpy's e**3 goes through pow() and costs ten times as much on a short vector.
        return parameters["kappa"] * (e * e * e)
