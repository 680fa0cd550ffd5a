"""Normal equations of features that are alive everywhere, summed in dense blocks, DOF by DOF."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.equation_rows import CHUNK, EquationRows, RowPattern
from pinn_cli.training.band.layout import BandLayout
from pinn_cli.training.band.row_sums import RowSums
from pinn_cli.training.band.subdomains import Subdomains


class DofMajorSums(RowSums):
    """Sums of features that are alive everywhere, per DOF; nothing is averaged.

    Args:
        layout: Where the weights stand.
        features: B, of the network's segments.
        pattern: Of the rows.
        like: A tensor of the dtype and device wanted.

    Attributes:
        columns: D B, local readout weights of a row.
        readout: (I, n, D B, D B + kinds F + 1).
        parameters: (n, kinds F, kinds F + 1).
    """

    def __init__(self, layout: BandLayout, features: int, pattern: RowPattern, like: Tensor) -> None:
        self.layout, self.pattern = layout, pattern
        groups, ndof = len(layout.local), layout.ndof
        self.features, self.columns = features, len(pattern.offsets) * features
        slots = int(np.prod(pattern.places.shape[1:]))
        self.readout = like.new_zeros((groups, ndof, self.columns, self.columns + slots + 1))
        self.parameters = like.new_zeros((ndof, slots, slots + 1))
        self._pairs: np.ndarray | None = None
        self._moments = np.zeros(layout.size)

    def add_rows(
        self,
        segments: Segments,
        rows: EquationRows,
        residual: Tensor,
        weight: Tensor,
        averages: Subdomains | None = None,
    ) -> None:
        """See :meth:`RowSums.add_rows`."""
        assert averages is None, "features that are alive everywhere have no intervals to average over"
        groups, samples, _ = segments.displacement.shape
        chunk = max(1, CHUNK // (groups * samples * self.readout.shape[-1]))
        for first in range(0, residual.shape[-1], chunk):
            dofs = slice(first, min(first + chunk, residual.shape[-1]))
            parts = (
                rows.jacobian(segments, dofs),
                rows.parameter[:, :, dofs].movedim(2, 1).flatten(3),
                residual[:, :, dofs].movedim(2, 1)[..., None],
            )
            table = torch.cat(parts, -1)
            table *= segments.mask[:, None, :, None]
            weighted = table[..., :-1] * weight[dofs][None, :, None, None]
            self.readout[:, dofs] += weighted[..., : self.columns].mT @ table
            by_parameter = table[..., self.columns :].movedim(1, 0).flatten(1, 2)
            self.parameters[dofs] += weighted[..., self.columns :].movedim(1, 0).flatten(1, 2).mT @ by_parameter

    def add_own_rows(self, segments: Segments, gram: Tensor, moment: Tensor, weight: Tensor) -> None:
        """See :meth:`RowSums.add_own_rows`."""
        first = self.pattern.own * self.features
        own = slice(first, first + self.features)
        self.readout[:, :, own, own] += gram[:, None] * weight[None, :, None, None]
        self.readout[:, :, own, -1] += (moment * weight).mT

    def add_pair(self, segments: Segments, products: Tensor, first: int, second: int) -> None:
        """See :meth:`RowSums.add_pair`."""
        if self._pairs is None:
            self._pairs = np.zeros((self.layout.half_width + 1, self.layout.size))
        feature = segments.feature.cpu().numpy()
        row, column = (self.layout.positions(feature, np.array(function)) for function in (first, second))
        lower, upper = np.maximum(row[:, :, None], column[:, None]), np.minimum(row[:, :, None], column[:, None])
        once = np.ones_like(lower, dtype=bool) if first != second else row[:, :, None] >= column[:, None]
        np.add.at(self._pairs, ((lower - upper)[once], upper[once]), products.cpu().numpy()[once])

    def add_moment(self, segments: Segments, moment: Tensor, function: int) -> None:
        """See :meth:`RowSums.add_moment`."""
        place = self.layout.positions(segments.feature.cpu().numpy(), np.array(function))
        np.add.at(self._moments, place, moment.cpu().numpy())

    def add_border(self, segments: Segments, moment: Tensor, function: int, place: int) -> None:
        """See :meth:`RowSums.add_border`."""
        position = self.layout.positions(segments.feature.cpu().numpy(), np.array(function))
        np.add.at(self._border[:, place], position, moment.cpu().numpy())

    @property
    def band(self) -> Diagonals:
        """See :attr:`RowSums.band`."""
        band = self.layout.band(self.readout[..., : self.columns]).cpu().numpy()
        return Diagonals.of_band(band if self._pairs is None else band + self._pairs)

    @property
    def gradient(self) -> np.ndarray:
        """See :attr:`RowSums.gradient`."""
        return self.layout.vector(self.readout[..., -1:])[:, 0].cpu().numpy() + self._moments

    @property
    def border(self) -> csr_matrix:
        """See :attr:`RowSums.border`."""
        return csr_matrix(self._border)

    @cached_property
    def _border(self) -> np.ndarray:
        """(size, places)."""
        border = self.readout.new_zeros((self.layout.size, self.pattern.count))
        for i, slots, place in self._used():
            columns = self.readout[:, i, :, self.columns : -1][..., slots]
            border[:, place] += self.layout.columns_of_dof(columns, i)
        return border.cpu().numpy()

    @cached_property
    def corner(self) -> np.ndarray:
        """See :attr:`RowSums.corner`."""
        corner = self.readout.new_zeros((self.pattern.count, self.pattern.count))
        for i, slots, place in self._used():
            corner[place[:, None], place] += self.parameters[i, :, :-1][slots[:, None], slots]
        return corner.cpu().numpy()

    @cached_property
    def slope(self) -> np.ndarray:
        """See :attr:`RowSums.slope`."""
        slope = self.readout.new_zeros(self.pattern.count)
        for i, slots, place in self._used():
            slope[place] += self.parameters[i, slots, -1]
        return slope.cpu().numpy()

    def _used(self) -> Iterator[tuple[int, Tensor, Tensor]]:
        """Every DOF with its parameters' slots that are used, and their places."""
        for i, places in enumerate(self.pattern.places.reshape(len(self.pattern.places), -1)):
            slots = np.flatnonzero(places >= 0)
            if slots.size:
                used = torch.as_tensor(np.stack((slots, places[slots])), device=self.readout.device)
                yield i, used[0], used[1]
