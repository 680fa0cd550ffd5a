"""Dry friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.settings.legal_values import positive_number
from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.base import Nonlinearity

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np


class Friction(Nonlinearity):
    """Coulomb's friction, smoothed: r_n = F_c tanh(de / speed), F_c in N.

    At three times the speed the force is 0.5 % below F_c. Within the speed the joint creeps, like a damper F_c / speed.

    Args:
        speed: Of the sliding over which the force changes its sign, m/s: small beside the speeds of the motion.

    Raises:
        InputError: ``speed`` is not positive.
    """

    name = "friction"
    parameters = ("F_c",)
    damping_parameter = "F_c"
    nonnegative = ("c", "k", "F_c")

    def __init__(self, speed: float) -> None:
        self.speed = positive_number("system.nonlinearity.speed", speed)
        self.reversal_speed = self.speed

    @property
    def titles(self) -> Mapping[str, str]:
        """See :attr:`Nonlinearity.titles`."""
        return {"F_c": "Friction"}

    @property
    def units(self) -> Mapping[str, str]:
        """See :attr:`Nonlinearity.units`."""
        return {"F_c": "N"}

    def damping_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.damping_at_rest`."""
        return parameters["F_c"] / self.speed

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        sliding: Array = namespace(de).tanh(de / self.speed)
        return parameters["F_c"] * sliding
