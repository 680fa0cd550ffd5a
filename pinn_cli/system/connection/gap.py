"""A gap that closes."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.settings.legal_values import one_of, positive_number
from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Nonlinearity

# Part of the motion at which an unknown gap starts.
CLOSES_WITHIN = 0.3
# The root of a length has a slope where it is this small, m.
SHORT = 1e-12
# The directions in which a gap can close.
SIDES = {"both": (1.0, -1.0), "positive": (1.0,), "negative": (-1.0,)}


class Gap(Nonlinearity):
    """A spring that is touched beyond a gap: r_n = k_g (e - gap) where e > gap, and k_g (e + gap) where e < -gap.

    A backlash has no k beside it. The corner is rounded over a part of the gap, so that the force is
    k_g rounding gap / 2 where the gap closes.

    Args:
        sides: On which the gap can close: both, or where the elongation is positive or negative alone.
        rounding: Over the gap.

    Raises:
        InputError: There is no such side, or ``rounding`` is not positive.
    """

    name = "gap"
    parameters = ("k_g", "gap")
    titles: Mapping[str, str] = {"k_g": "Contact stiffness", "gap": "Gap"}
    units: Mapping[str, str] = {"k_g": "N/m", "gap": "m"}
    nonnegative = ("c", "k", "k_g", "gap")
    is_stiff = True

    def __init__(self, sides: str = "both", rounding: float = 0.002) -> None:
        self.sides = one_of("system.nonlinearity.sides", sides, tuple(SIDES))
        self.rounding = positive_number("system.nonlinearity.rounding", rounding)

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        gap = parameters["gap"]
        width = (self.rounding * gap) ** 2 + SHORT**2
        at_rest = (gap**2 + width) ** 0.5
        pushed = 0.0 * e
        for side in SIDES[self.sides]:
            pushed = pushed + (e + side * (((side * e - gap) ** 2 + width) ** 0.5 - at_rest)) / 2.0
        return parameters["k_g"] * pushed

    def starts(self, stiffness: float, elongation: float) -> Mapping[str, tuple[float, ...]]:
        """See :meth:`Nonlinearity.starts`: a gap within the motion, and a contact as stiff as it seems without."""
        return {"k_g": (stiffness, stiffness), "gap": (CLOSES_WITHIN * elongation, elongation)}
