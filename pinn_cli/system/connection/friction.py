"""Dry friction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pinn_cli.settings.legal_values import positive_number
from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.nonlinearity import Nonlinearity

# Of a contact that sticks, m/s: a load of 0.8 F_c makes it creep by 0.1 um in a second.
STUCK = 1e-7


class Friction(Nonlinearity):
    """Coulomb's friction: r_n = F_c tanh(de / speed), F_c in N.

    At three times the speed the force is 0.5 % below F_c. Within the speed the joint creeps, like a damper F_c / speed.

    Args:
        speed: Of the sliding over which the force changes its sign, m/s; None: the joint sticks.

    Raises:
        InputError: ``speed`` is not positive.
    """

    name = "friction"
    parameters = ("F_c",)
    titles: Mapping[str, str] = {"F_c": "Friction"}
    units: Mapping[str, str] = {"F_c": "N"}
    nonnegative = ("c", "k", "F_c")
    reversal_speed: float

    def __init__(self, speed: float | None = None) -> None:
        self.speed = None if speed is None else positive_number("system.nonlinearity.speed", speed)
        self.reversal_speed = STUCK if self.speed is None else self.speed
        self.is_stiff = self.speed is None

    def turning_over(self, speed: float) -> Friction:
        """See :meth:`Nonlinearity.turning_over`."""
        return Friction(max(speed, STUCK)) if self.speed is None else self

    def damping_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.damping_at_rest`."""
        return parameters["F_c"] / self.reversal_speed

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        sliding: Array = namespace(de).tanh(de / self.reversal_speed)
        return parameters["F_c"] * sliding
