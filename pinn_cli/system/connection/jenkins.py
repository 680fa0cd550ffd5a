"""A contact that gives way before it slides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pinn_cli.settings.legal_values import positive_number
from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.nonlinearity import Hysteresis

# Part of the motion within which a contact sticks that k_t starts at.
STICKS_WITHIN = 0.05


class Jenkins(Hysteresis):
    """A spring k_t with a friction slider F_c behind it (Jenkins, J. Appl. Phys. 33, 1962): r = c de + k e + z.

    dz/dt = k_t de (1 - |z / F_c|^sharpness) where the force grows, k_t de where it falls. At rest it holds its load,
    whatever the speed was before. For a large sharpness it is linear up to F_c.

    Args:
        sharpness: Of the turn from sticking to sliding.

    Raises:
        InputError: ``sharpness`` is not positive.
    """

    name = "jenkins"
    parameters = ("k_t", "F_c")
    titles: Mapping[str, str] = {"k_t": "Contact stiffness", "F_c": "Friction"}
    units: Mapping[str, str] = {"k_t": "N/m", "F_c": "N"}
    nonnegative = ("c", "k", "k_t", "F_c")
    is_stiff = True

    def __init__(self, sharpness: float = 4.0) -> None:
        self.sharpness = positive_number("system.nonlinearity.sharpness", sharpness)

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`: all of it is hidden."""
        return namespace(e).zeros_like(e)

    def rate(self, e: Array, de: Array, states: Sequence[Array], parameters: Mapping[str, Array]) -> Sequence[Array]:
        """See :meth:`Hysteresis.rate`."""
        k_t, limit = parameters["k_t"], parameters["F_c"]
        (z,) = states
        where = namespace(z).where
        grows = z * de > 0
        # Without a limit nothing holds, and the slope by the limit is a number there as well.
        size = where(grows, abs(z), 0.0) / where(limit > 0, limit, 1.0)
        share = where(size > 0, where(size > 0, size, 1.0) ** self.sharpness, 0.0)
        return (where(limit > 0, k_t * de * (1.0 - share), 0.0 * de),)

    def creates_energy(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """See :meth:`Hysteresis.creates_energy`: it never does."""
        return np.zeros(np.shape(parameters["F_c"]), dtype=bool)

    def starts(self, stiffness: float, elongation: float) -> Mapping[str, tuple[float, ...]]:
        """See :meth:`Nonlinearity.starts`: a contact that sticks within a small part of the motion."""
        force = STICKS_WITHIN * stiffness * elongation
        return {"k_t": (stiffness, stiffness), "F_c": (force, stiffness * elongation)}

    def stiffness_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """See :meth:`Hysteresis.stiffness_at_rest`."""
        return parameters["k_t"]
