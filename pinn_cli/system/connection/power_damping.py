"""Power-law damper."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_finite_number
from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.nonlinearity import Nonlinearity


class PowerDamping(Nonlinearity):
    """Power-law damper, r_n = mu |de|^p sign(de), mu in N (s/m)^p; p = 2 is drag in a turbulent fluid.

    Args:
        exponent: p >= 1. Below one the slope at rest is infinite and no integrator or gradient survives it.

    Raises:
        InputError: ``exponent`` is not a finite number >= 1.
    """

    name = "power_damping"
    parameters = ("mu",)
    titles: Mapping[str, str] = {"mu": "Power-law damping"}
    nonnegative = ("c", "k", "mu")

    def __init__(self, exponent: float = 2.0) -> None:
        if not is_finite_number(exponent) or exponent < 1.0:
            hint = "below 1 the slope at rest is infinite"
            raise InputError("system.nonlinearity.exponent", exponent, "a finite number >= 1", hint)
        self.exponent = float(exponent)
        self.units = {"mu": f"N (s/m)^{self.exponent:g}"}

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        if self.exponent == 1.0:
            return parameters["mu"] * de
        # For 1 < p < 2 the chain rule meets (p - 1) 0^(p - 2) * sign(0) = inf * 0 at rest, where the derivative is
        # plainly 0: keep the power away from zero and put the zero back.
        where = namespace(de).where
        speed = where(de == 0, 1.0, abs(de))
        gain: Array = where(de == 0, 0.0, speed ** (self.exponent - 1.0))
        return parameters["mu"] * gain * de
