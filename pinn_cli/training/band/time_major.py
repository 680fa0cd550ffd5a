"""Normal equations of local features, summed diagonal by diagonal of the band.

With the weights ordered by feature, then by DOF, the weight of (feature f, DOF j) stands at f n + j. A row of DOF i in
knot interval g then touches weights at (g + b) n + i + d, with b among the features that are alive and d = -1, 0, 1. So
one entry of all rows' local products, taken over intervals and DOFs, is one contiguous piece of one diagonal of the
band: no index is looked up, and no local block is ever stored.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.band.chain_rows import CHUNK, ChainRows
from pinn_cli.training.band.subdomains import Subdomains


class TimeMajorSums:
    """Sums over rows [J | P | r] of weighted products, as the parts of a bordered band.

    Args:
        stride: Features that one knot interval moves on by: the outputs of a DOF.
        features: B, alive at once.
        count: Of one DOF in all.
        ndof: n.
        kinds: Kinds of uncertain parameters.

    Attributes:
        gradient: (size,).
        border: (size, kinds, n), of the readout weights against the parameters.
        corner: (kinds, n, kinds, n), of the parameters against each other.
        slope: (kinds, n), their gradient.
    """

    def __init__(self, stride: int, features: int, count: int, ndof: int, kinds: int) -> None:
        self.stride, self.features, self.n, self.size = stride, features, ndof, count * ndof
        self.half_width = (features - 1) * ndof + min(2, ndof - 1)
        # One entry more in front and behind: rows at the chain's ends add zeros there.
        self._band = np.zeros((self.half_width + 1, self.size + 2))
        self._gradient = np.zeros(self.size + 2)
        self._border = np.zeros((kinds, ndof, self.size + 2))
        self.corner = np.zeros((kinds, ndof, kinds, ndof))
        self.slope = np.zeros((kinds, ndof))

    @property
    def band(self) -> np.ndarray:
        """(half_width + 1, size), lower band: [i - j, j] is entry [i, j]."""
        return self._band[:, 1:-1]

    @property
    def gradient(self) -> np.ndarray:
        """(size,), of the readout weights."""
        return self._gradient[1:-1]

    @property
    def border(self) -> np.ndarray:
        """(size, kinds, n), of the readout weights against the parameters."""
        return self._border[..., 1:-1].transpose(2, 0, 1)

    def add_chain_rows(
        self,
        segments: Segments,
        rows: ChainRows,
        residual: Tensor,
        weight: Tensor,
        averages: Subdomains | None = None,
    ) -> None:
        """Add rows that touch three DOFs and the parameters.

        Args:
            segments: Of the points, I groups of S.
            rows: The linearised equation of motion there.
            residual: (I, S, n), or (I, 1, n) of averages.
            weight: (n,), or as large as the residual.
            averages: Of the rows, where the residual is averaged.
        """
        table = self._table(segments, rows, residual, averages)  # (C, I, S, n)
        table *= np.broadcast_to(weight.cpu().numpy(), residual.shape) ** 0.5
        if averages is None:
            table *= segments.mask.cpu().numpy()[:, :, None]
        first = (segments.feature[:, 0] // self.stride).cpu().numpy()
        for start, stop in _runs(first):
            for sample in range(table.shape[2]):
                part = table[:, start:stop, sample]
                self._add_readout(part, int(first[start]))
                self._add_parameters(part, int(first[start]))

    def add_own_rows(self, segments: Segments, gram: Tensor, moment: Tensor, weight: Tensor) -> None:
        """Add rows that touch their own DOF.

        Args:
            segments: Their groups.
            gram: (I, B, B) of their features.
            moment: (I, B, n), features against residual.
            weight: (n,).
        """
        first = (segments.feature[:, 0] // self.stride).cpu().numpy()
        products, moments, scale = gram.cpu().numpy(), moment.cpu().numpy(), weight.cpu().numpy()
        for start, stop in _runs(first):
            place = int(first[start]) * self.stride * self.n + 1
            for a in range(self.features):
                self._cells(self._gradient, place + a * self.n, stop - start)[...] += moments[start:stop, a] * scale
                for b in range(a + 1):
                    cells = self._cells(self._band[(a - b) * self.n], place + b * self.n, stop - start)
                    cells += products[start:stop, a, b, None] * scale

    def _table(self, segments: Segments, rows: ChainRows, residual: Tensor, averages: Subdomains | None) -> np.ndarray:
        """(C, I, S, n), columns: the features of DOFs i-1, i, i+1, the parameters, the residual."""
        groups, samples, n = segments.displacement.shape[0], residual.shape[1], self.n
        pairs = rows.parameter.shape[-2] * 2
        columns = 3 * self.features + pairs + 1
        table = np.empty((columns, groups, samples, n))
        table[-1] = residual.cpu().numpy()
        by_parameter = (
            rows.parameter.flatten(3)
            if averages is None
            else averages(rows.parameter.flatten(2)).unflatten(2, (n, pairs))
        )
        table[3 * self.features : -1] = by_parameter.permute(3, 0, 1, 2).cpu().numpy()
        chunk = max(1, CHUNK // segments.displacement.numel())
        for start in range(0, n, chunk):
            dofs = slice(start, min(start + chunk, n))
            slopes = rows.jacobian(segments, dofs)  # (I, dofs, S, 3 B)
            slopes = slopes if averages is None else averages(slopes)
            table[: 3 * self.features, :, :, dofs] = slopes.permute(3, 0, 2, 1).cpu().numpy()
        # The ground does not move, and nothing lies beyond the last DOF.
        table[: self.features, :, :, 0] = 0.0
        table[2 * self.features : 3 * self.features, :, :, -1] = 0.0
        return table

    def _offsets(self) -> list[int]:
        """Of every local weight of a row, from the weight of the row's own DOF and the first feature alive."""
        return [b * self.n + d for d in (-1, 0, 1) for b in range(self.features)]

    def _cells(self, line: np.ndarray, start: int, groups: int) -> np.ndarray:
        """(groups, n) view of a line from ``start`` on, one interval after the other."""
        step = self.stride * self.n
        size = line.strides[0]
        return np.lib.stride_tricks.as_strided(line[start:], (groups, self.n), (step * size, size))

    def _add_readout(self, part: np.ndarray, first: int) -> None:
        """Products of the local weights' columns, and of each with the residual; ``part`` is (C, I, n)."""
        offsets, place = self._offsets(), first * self.stride * self.n + 1
        for a, above in enumerate(offsets):
            column = part[a]
            self._cells(self._gradient, place + above, part.shape[1])[...] += column * part[-1]
            for b, below in enumerate(offsets):
                # Two columns at one offset, or further apart than the band is wide, are never in one row: one is zero.
                if 0 < above - below <= self.half_width or a == b:
                    self._cells(self._band[above - below], place + below, part.shape[1])[...] += column * part[b]

    def _add_parameters(self, part: np.ndarray, first: int) -> None:
        """Products of the parameters' columns with everything; connections i and i + 1 of each row of DOF i."""
        kinds, n = self.slope.shape
        if not kinds:
            return
        own = part[3 * self.features : -1].reshape(kinds, 2, *part.shape[1:])
        offsets, place = self._offsets(), first * self.stride * self.n + 1
        step = self.stride * n
        for x in range(2):
            touched = slice(0, n - x)
            self.slope[:, x:] += np.einsum("kin,in->kn", own[:, x, :, touched], part[-1][:, touched])
            for y in range(2):
                both = slice(0, n - max(x, y))
                sums = np.einsum("kin,lin->kln", own[:, x, :, both], own[:, y, :, both])
                for i in range(n - max(x, y)):
                    self.corner[:, i + x, :, i + y] += sums[:, :, i]
            for kind in range(kinds):
                for a, offset in enumerate(offsets):
                    products = own[kind, x] * part[a]
                    for i in range(n - x):
                        start = place + offset + i
                        self._border[kind, i + x, start : start + step * part.shape[1] : step] += products[:, i]


def _runs(first: np.ndarray) -> list[tuple[int, int]]:
    """Ranges of groups whose first features follow one another."""
    breaks = np.flatnonzero(np.diff(first) != 1) + 1
    ends = [0, *breaks.tolist(), len(first)]
    return list(pairwise(ends))
