"""Bouc-Wen hysteresis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.nonlinearity import Hysteresis

# Part of the elongation's inverse that beta starts at, and the scale of n about one.
FIRST_BEND, N_SCALE = 0.3, 0.05


class BoucWen(Hysteresis):
    """Hysteresis of Bouc (1967) and Wen (J. Eng. Mech. Div. 102, 1976): r = c de + k e + z with a hidden force z.

    dz/dt = A de - beta |de| |z|^(n-1) z - gamma de |z|^n.

    A in N/m, n without unit, beta and gamma in N^(1-n)/m: 1/m for n = 1. It dissipates where beta > 0 and
    -beta <= gamma <= beta; other values can create energy, and are told, not refused.
    """

    name = "bouc_wen"
    parameters: tuple[str, ...] = ("A", "beta", "gamma", "n")
    titles: Mapping[str, str] = {
        "A": "Hysteretic stiffness",
        "beta": "Hysteresis",
        "gamma": "Hysteresis",
        "n": "Sharpness",
    }
    units: Mapping[str, str] = {"A": "N/m", "beta": "1/m", "gamma": "1/m", "n": "1"}
    nonnegative: tuple[str, ...] = ("c", "k", "A", "n")

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`: all of it is hidden."""
        return namespace(e).zeros_like(e)

    def rate(self, e: Array, de: Array, states: Sequence[Array], parameters: Mapping[str, Array]) -> Sequence[Array]:
        """See :meth:`Hysteresis.rate`."""
        (z,) = states
        a, beta, gamma, n = (parameters[name] for name in BoucWen.parameters)
        # At z = 0 a power's slope by n is 0 times an infinite logarithm: keep it away and put the zero back.
        where = namespace(z).where
        size = where(z == 0, 1.0, abs(z))
        power = where(z == 0, 0.0, size**n)
        sign = where(z == 0, 0.0, z / size)
        return (a * de - (beta * abs(de) * sign + gamma * de) * power,)

    def creates_energy(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """See :meth:`Hysteresis.creates_energy`: all but beta >= 0 and -beta <= gamma <= beta."""
        return np.abs(parameters["gamma"]) > parameters["beta"]

    def starts(self, stiffness: float, elongation: float) -> Mapping[str, tuple[float, ...]]:
        """See :meth:`Nonlinearity.starts`: half of the spring is hidden, and it yields at the elongation that there is.

        With gamma at zero the loop is thickest; A and the spring beside it cannot be told apart without any.
        """
        bend = 1.0 / elongation
        half = stiffness / 2.0
        return {
            "k": (half, stiffness),
            "A": (half, stiffness),
            "beta": (FIRST_BEND * bend, bend),
            "gamma": (0.0, bend),
            "n": (1.0, N_SCALE),
        }

    def stiffness_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """See :meth:`Hysteresis.stiffness_at_rest`."""
        return parameters["A"]
