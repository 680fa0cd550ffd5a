"""Normal equations of local features of functions that are all coupled, such as modes: a dense block an interval."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.equation_rows import EquationRows, RowPattern
from pinn_cli.training.band.subdomains import Subdomains
from pinn_cli.training.band.time_major import TimeMajorSums

# Intervals whose blocks are held at once.
CHUNK = 64


class BlockSums(TimeMajorSums):
    """The sums of :class:`TimeMajorSums`; rows that touch every function are multiplied as dense ones."""

    def __init__(self, stride: int, features: int, count: int, pattern: RowPattern) -> None:
        super().__init__(stride, features, count, pattern)
        self._band = np.zeros((self.half_width + 1, self._length))
        self._diagonals = dict(enumerate(self._band))

    @property
    def band(self) -> Diagonals:
        """See :attr:`RowSums.band`."""
        return Diagonals.of_band(self._band[:, self._inside])

    def add_rows(
        self,
        segments: Segments,
        rows: EquationRows,
        residual: Tensor,
        weight: Tensor,
        averages: Subdomains | None = None,
    ) -> None:
        """See :meth:`RowSums.add_rows`."""
        width = self.features * self.n
        row, column = np.tril_indices(width)
        place = (row - column) * self._band.shape[1] + column + self.margin
        band = self._band.reshape(-1)
        first = (segments.feature[:, 0] // self.stride).cpu().numpy() * self.stride * self.n
        root = weight.broadcast_to(residual.shape).sqrt()
        for start in range(0, len(first), CHUNK):
            part = slice(start, start + CHUNK)
            table = self._rows(segments, rows, residual, averages, part) * root[part, ..., None]
            if averages is None:
                table = table * segments.mask[part, :, None, None]
            table = table.flatten(1, 2)
            products = (table.mT @ table).cpu().numpy()  # (intervals, C, C)
            for at, product in zip(first[part], products, strict=True):
                band[place + at] += product[row, column]
                here = slice(self.margin + at, self.margin + at + width)
                self._gradient[here] += product[:width, -1]
                self._dense_border[:, here] += product[width:-1, :width]
            total = products[:, width:-1, width:].sum(0)
            self._corner += total[:, :-1]
            self._slope += total[:, -1]

    def _rows(
        self, segments: Segments, rows: EquationRows, residual: Tensor, averages: Subdomains | None, part: slice
    ) -> Tensor:
        """(intervals, S, n, C), columns: features of all functions in the band's order, parameters, residual."""
        order = torch.as_tensor(self.pattern.order, device=residual.device)
        stiffness, damping = (self._every_function(x[part])[..., order] for x in (rows.stiffness, rows.damping))
        parameter = self._every_parameter(rows.parameter[part])
        value, rate, curvature = (
            getattr(segments, name)[part] for name in ("displacement", "velocity", "acceleration")
        )
        if averages is None:
            jacobian = value[:, :, None, :, None] * stiffness[:, :, :, None]
            jacobian += rate[:, :, None, :, None] * damping[:, :, :, None]
        else:
            share = averages.weight[part, :, None]
            jacobian = (value * share).mT @ stiffness.flatten(2) + (rate * share).mT @ damping.flatten(2)
            jacobian = jacobian.unflatten(-1, (self.n, self.n)).movedim(1, 2)[:, None]
            curvature = (curvature * share).sum(1, keepdim=True)
            parameter = (share[..., None] * parameter).sum(1, keepdim=True)
        if rows.mass is not None:
            own = torch.argsort(order)
            jacobian[:, :, torch.arange(self.n), :, own] += (curvature[..., None] * rows.mass).movedim(-1, 0)
        return torch.cat((jacobian.flatten(3), parameter, residual[part, ..., None]), -1)

    def _every_function(self, slots: Tensor) -> Tensor:
        """(..., n, n), derivatives by every function, from those in the slots of a pattern (..., n, D)."""
        neighbours = np.where(self.pattern.coupled, self.pattern.dynamics.coupling.neighbours, self.n)
        out = slots.new_zeros((*slots.shape[:-1], self.n + 1))
        index = torch.as_tensor(neighbours, device=slots.device)
        return out.scatter_(-1, index.expand(slots.shape), slots)[..., : self.n]

    def _every_parameter(self, slots: Tensor) -> Tensor:
        """(..., n, places), derivatives by the parameters, from those in the slots of a pattern (..., n, kinds, F)."""
        count = self.pattern.count
        places = torch.as_tensor(np.where(self.pattern.places < 0, count, self.pattern.places), device=slots.device)
        out = slots.new_zeros((*slots.shape[:-2], count + 1))
        flat = slots.flatten(-2)
        return out.scatter_add_(-1, places.flatten(-2).expand(flat.shape), flat)[..., :count]
