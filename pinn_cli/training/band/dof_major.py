"""Normal equations of features that are alive everywhere, summed in dense blocks, DOF by DOF."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.band.chain_rows import CHUNK, ChainRows
from pinn_cli.training.band.layout import BandLayout
from pinn_cli.training.band.subdomains import Subdomains


class DofMajorSums:
    """Sums over rows [J | P | r] of weighted products, per DOF, as the parts of a bordered band.

    Args:
        layout: Where the weights stand.
        features: B, of the network's segments.
        kinds: Kinds of uncertain parameters.
        like: A tensor of the dtype and device wanted.

    Attributes:
        columns: 3 B, local readout weights of a row.
        readout: (I, n, 3 B, 3 B + 2 kinds + 1).
        parameters: (n, 2 kinds, 2 kinds + 1).
    """

    def __init__(self, layout: BandLayout, features: int, kinds: int, like: Tensor) -> None:
        self.layout, self.kinds = layout, kinds
        groups, ndof = len(layout.local), layout.ndof
        self.features, self.columns = features, 3 * features
        width = self.columns + 2 * kinds + 1
        self.readout = like.new_zeros((groups, ndof, self.columns, width))
        self.parameters = like.new_zeros((ndof, 2 * kinds, 2 * kinds + 1))

    def add_chain_rows(
        self,
        segments: Segments,
        rows: ChainRows,
        residual: Tensor,
        weight: Tensor,
        averages: Subdomains | None = None,
    ) -> None:
        """Add rows that touch three DOFs and the parameters; residual (I, S, n), weight (n,); nothing is averaged."""
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
        """Add rows that touch their own DOF: gram (I, B, B) of their features, moment (I, B, n), weight (n,)."""
        own = slice(self.features, 2 * self.features)
        self.readout[:, :, own, own] += gram[:, None] * weight[None, :, None, None]
        self.readout[:, :, own, -1] += (moment * weight).mT

    @property
    def band(self) -> np.ndarray:
        """(half_width + 1, size), lower band: [i - j, j] is entry [i, j]."""
        return self.layout.band(self.readout[..., : self.columns]).cpu().numpy()

    @property
    def gradient(self) -> np.ndarray:
        """(size,), of the readout weights."""
        return self.layout.vector(self.readout[..., -1:])[:, 0].cpu().numpy()

    @cached_property
    def border(self) -> np.ndarray:
        """(size, kinds, n), of the readout weights against the parameters."""
        n, kinds = self.layout.ndof, self.kinds
        border = self.readout.new_zeros((self.layout.size, kinds, n))
        for i in range(n) if kinds else ():
            against = self.layout.columns_of_dof(self.readout[:, i, :, self.columns : -1], i).unflatten(-1, (kinds, 2))
            border[:, :, i : i + 2] += against[..., : min(2, n - i)]
        return border.cpu().numpy()

    @cached_property
    def corner(self) -> np.ndarray:
        """(kinds, n, kinds, n), of the parameters against each other."""
        n, kinds = self.layout.ndof, self.kinds
        corner = self.readout.new_zeros((kinds, n, kinds, n))
        for i in range(n) if kinds else ():
            block = self.parameters[i, :, :-1].reshape(kinds, 2, kinds, 2)
            ends = min(2, n - i)
            corner[:, i : i + ends, :, i : i + ends] += block[:, :ends, :, :ends]
        return corner.cpu().numpy()

    @cached_property
    def slope(self) -> np.ndarray:
        """(kinds, n), gradient of the parameters."""
        n, kinds = self.layout.ndof, self.kinds
        slope = self.readout.new_zeros((kinds, n))
        for i in range(n) if kinds else ():
            slope[:, i : i + 2] += self.parameters[i, :, -1].reshape(kinds, 2)[:, : min(2, n - i)]
        return slope.cpu().numpy()
