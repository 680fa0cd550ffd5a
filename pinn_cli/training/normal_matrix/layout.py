"""Where each unknown of a linear readout stands."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.runs.process import of_this_machine
from pinn_cli.settings.errors import InputError
from pinn_cli.training.normal_matrix.dissection import Dissection, Grid
from pinn_cli.training.normal_matrix.row_pattern import RowPattern

# Held at the same time as the factor: what the motion does with each parameter, in two units.
BORDERS = 2


class BandLayout:
    """The readout weights one feature after the other, those of each by the functions in the order of their pattern.

    A residual touches the features alive at its time, of functions that are coupled. Where those are at most R apart
    (of a chain 2), the normal matrix of n functions is a band of half-width (span of features alive together) n + R.

    Args:
        feature: (I, B) long, the features of one function that are alive in each group.
        count: Features of one function in all.
        pattern: Which functions are coupled.

    Attributes:
        dissection: The order of elimination.

    Raises:
        InputError: This machine cannot hold the factor, counted before it is made.
    """

    def __init__(self, feature: Tensor, count: int, pattern: RowPattern) -> None:
        groups = feature.numpy()
        span = int((groups.max(axis=1) - groups.min(axis=1)).max())
        self.pattern, self.count, self.ndof = pattern, count, len(pattern.coupled)
        self.size, self.half_width = count * self.ndof, span * self.ndof + pattern.reach
        self.dissection = Dissection(Grid(count, self.ndof, span, pattern.reach, pattern.count))
        numbers = self.dissection.cheapest.entries + BORDERS * self.size * pattern.count
        needed, memory = 8 * numbers, of_this_machine()
        if needed > memory:
            allowed = f"such that a run fits into the memory of this machine, {memory / 2**30:.3g} GiB"
            rows = f"{self.count} features x {self.ndof} DOFs in a band of {self.half_width + 1}"
            hint = f"{rows} take {needed / 2**30:.3g} GiB; a shorter record has fewer features"
            raise InputError("system.ndof", self.ndof, allowed, hint)

    def columns(self, feature: Tensor, coupled: bool = True) -> np.ndarray:
        """(I, n, D B): position of each unknown that a residual touches, -1 in unused slots.

        Args:
            feature: (I, B), features alive in each group.
            coupled: Whether it touches the DOFs that are coupled with its own; otherwise its own alone, D = 1.
        """
        offsets, used = (
            (self.pattern.offsets, self.pattern.coupled) if coupled else ((0,), np.ones((self.ndof, 1), bool))
        )
        place = (self.pattern.rank[:, None] + np.array(offsets))[None, :, :, None]
        groups = feature.numpy()
        position = groups[:, None, None, :] * self.ndof + place
        return np.where(used[None, :, :, None], position, -1).reshape(len(groups), self.ndof, -1)

    def positions(self, feature: np.ndarray, dof: np.ndarray) -> np.ndarray:
        """Position of the weight of (feature, dof) in the vector of unknowns."""
        position: np.ndarray = feature * self.ndof + self.pattern.rank[dof]
        return position

    def unknowns(self, weights: Tensor) -> Tensor:
        """Readout weights (count, ndof) as the vector of unknowns (size,)."""
        return self.pattern.in_order(weights).reshape(-1)

    def weights(self, unknowns: Tensor) -> Tensor:
        """Vector of unknowns (size,) as readout weights (count, ndof)."""
        placed = unknowns.reshape(self.count, self.ndof)
        return placed if self.pattern.natural else placed[:, torch.as_tensor(self.pattern.rank)]
