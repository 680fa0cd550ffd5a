"""Where each unknown of a linear readout stands, so that the normal matrix is a narrow band."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pinn_cli.runs.memory import of_this_machine
from pinn_cli.settings.errors import InputError
from pinn_cli.training.band.dissection import Dissection, Grid
from pinn_cli.training.band.equation_rows import RowPattern

# Held at the same time as the factor: what the motion does with each parameter, in two units.
BORDERS = 2


class BandLayout:
    """Order of the readout weights (feature, dof) that gives the normal matrix the narrower band.

    A residual of a DOF touches the features alive at its time, of the DOFs that are coupled with it. Where those are
    at most R apart (of a chain 2), the half-width is (span of features alive together) * n + R ordered by feature first
    (local features: splines), and R * count + span ordered by DOF first (global features: Fourier).

    Args:
        feature: (I, B) long, the features of one DOF that are alive in each group.
        count: Features of one DOF in all.
        pattern: Which DOFs are coupled.
        feature_first: Which order; None: the narrower.

    Attributes:
        dissection: The order of elimination.

    Raises:
        InputError: This machine cannot hold the factor, counted before it is made.
    """

    def __init__(self, feature: Tensor, count: int, pattern: RowPattern, feature_first: bool | None = None) -> None:
        groups = feature.cpu().numpy()
        span = int((groups.max(axis=1) - groups.min(axis=1)).max())
        self.pattern, ndof = pattern, len(pattern.coupled)
        by_feature, by_dof = span * ndof + pattern.reach, pattern.reach * count + span
        self.feature_first = by_feature <= by_dof if feature_first is None else feature_first
        self.half_width = by_feature if self.feature_first else by_dof
        self.count, self.ndof, self.size = count, ndof, count * ndof
        self.dissection = Dissection(
            Grid(count, ndof, span, pattern.reach, pattern.count)
            if self.feature_first
            else Grid(ndof, count, pattern.reach, span, pattern.count)
        )
        self._check_memory()
        self._feature, self.device = feature, feature.device

    def _check_memory(self) -> None:
        numbers = self.dissection.best.entries + BORDERS * self.size * self.pattern.count
        needed, memory = 8 * numbers, of_this_machine()
        if needed > memory:
            allowed = f"such that a run fits into the memory of this machine, {memory / 2**30:.3g} GiB"
            rows = f"{self.count} features x {self.ndof} DOFs in a band of {self.half_width + 1}"
            hint = f"{rows} take {needed / 2**30:.3g} GiB; a shorter record has fewer features"
            raise InputError("system.ndof", self.ndof, allowed, hint)

    @cached_property
    def local(self) -> np.ndarray:
        """The :meth:`columns` of all groups."""
        return self.columns(self._feature)

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
        groups = feature.cpu().numpy()
        position = self._position(groups[:, None, None, :], place)
        return np.where(used[None, :, :, None], position, -1).reshape(len(groups), self.ndof, -1)

    @cached_property
    def _band_maps(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Which entries of local blocks are kept and where they go, of the band and of a vector."""
        row, column = self.local[..., :, None], self.local[..., None, :]
        kept = (row >= column) & (column >= 0)
        row, column = np.broadcast_to(row, kept.shape)[kept], np.broadcast_to(column, kept.shape)[kept]
        alive = self.local.reshape(-1) >= 0
        every = (np.flatnonzero(kept), (row - column) * self.size + column, np.flatnonzero(alive))
        kept_entries, target, kept_rows = (torch.as_tensor(x, device=self.device) for x in every)
        return kept_entries, target, kept_rows, torch.as_tensor(self.local.reshape(-1)[alive], device=self.device)

    def positions(self, feature: np.ndarray, dof: np.ndarray) -> np.ndarray:
        """Position of the weight of (feature, dof) in the vector of unknowns."""
        return self._position(feature, self.pattern.rank[dof])

    def _position(self, feature: np.ndarray, place: np.ndarray) -> np.ndarray:
        return feature * self.ndof + place if self.feature_first else place * self.count + feature

    def band(self, blocks: Tensor) -> Tensor:
        """Sum local blocks (I, n, C, C) into the lower band (half_width + 1, size); [i - j, j] is entry [i, j]."""
        out = blocks.new_zeros((self.half_width + 1) * self.size)
        kept, target, _, _ = self._band_maps
        out.index_add_(0, target, blocks.reshape(-1)[kept])
        return out.reshape(self.half_width + 1, self.size)

    def vector(self, blocks: Tensor) -> Tensor:
        """Sum local blocks (I, n, C, ...) into (size, ...)."""
        trailing = blocks.shape[3:]
        out = blocks.new_zeros((self.size, *trailing))
        _, _, kept, target = self._band_maps
        return out.index_add_(0, target, blocks.reshape(-1, *trailing)[kept])

    def columns_of_dof(self, blocks: Tensor, dof: int) -> Tensor:
        """Sum the local blocks (I, C, ...) of one residual's DOF into (size, ...)."""
        local = torch.as_tensor(self.local[:, dof].reshape(-1), device=blocks.device)
        alive = local >= 0
        flat = blocks.reshape(-1, *blocks.shape[2:])
        return blocks.new_zeros((self.size, *blocks.shape[2:])).index_add_(0, local[alive], flat[alive])

    def unknowns(self, weights: Tensor) -> Tensor:
        """Readout weights (count, ndof) as the vector of unknowns (size,)."""
        placed = weights if self._natural else weights[:, torch.as_tensor(self.pattern.order, device=weights.device)]
        return (placed if self.feature_first else placed.T).reshape(-1)

    def weights(self, unknowns: Tensor) -> Tensor:
        """Vector of unknowns (size,) as readout weights (count, ndof)."""
        by_feature = self.count, self.ndof
        placed = unknowns.reshape(by_feature) if self.feature_first else unknowns.reshape(by_feature[::-1]).T
        return placed if self._natural else placed[:, torch.as_tensor(self.pattern.rank, device=unknowns.device)]

    def of_many(self, unknowns: Tensor) -> Tensor:
        """Vectors of unknowns (size, W) as readout weights (count, ndof, W)."""
        return torch.stack([self.weights(one) for one in unknowns.T], -1)

    @property
    def _natural(self) -> bool:
        return bool((self.pattern.order == np.arange(self.ndof)).all())
