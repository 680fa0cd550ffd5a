"""Where Gauss-Newton stands, and how it moves where parameters have bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
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


class Bounded:
    """Unknowns of which the parameters may have bounds.

    Attributes:
        lower: (p,), bounds in prior standard deviations from the prescribed values; -inf without one.
    """

    lower: np.ndarray

    def split(self, point: Point) -> list[Point]:
        """The point of every record: there is one."""
        return [point]

    def joined(self, points: Sequence[Point]) -> Point:
        """The point of all records from that of each."""
        return points[0]

    def room_below(self, point: Point) -> np.ndarray:
        """(p,), the most negative step of every parameter that respects its bound; -inf without one."""
        room: np.ndarray = self.lower - point.parameters.cpu().numpy()
        return np.minimum(room, 0.0)

    def moved(self, point: Point, step: tuple[np.ndarray, np.ndarray]) -> Point:
        """The point after a step; a parameter that the step takes to its bound is at the bound, whatever the rounding.

        Args:
            point: Where the step begins.
            step: Of the readout weights (size,) and of the parameters (p,).
        """
        unknowns, parameters = (torch.as_tensor(x).to(point.unknowns) for x in step)
        lower = torch.as_tensor(self.lower).to(point.unknowns)
        held = torch.as_tensor(step[1] <= self.room_below(point), device=lower.device)
        after = point.moved((unknowns, parameters))
        return Point(after.unknowns, torch.where(held, lower, torch.maximum(after.parameters, lower)))
