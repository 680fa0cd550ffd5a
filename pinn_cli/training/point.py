"""Where Gauss-Newton stands."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, eq=False)
class Point:
    """Where Gauss-Newton stands.

    Attributes:
        unknowns: (size,) readout weights in the layout's order; of several records one after the other.
        parameters: (p,) uncertain parameters, in prior standard deviations from their prescribed values.
    """

    unknowns: Tensor
    parameters: Tensor

    def moved(self, step: tuple[Tensor, Tensor]) -> Point:
        """The point after a step."""
        return Point(self.unknowns + step[0], self.parameters + step[1])
