"""Normal equations of local features, summed diagonal by diagonal of the band.

With the weights ordered by feature, then by DOF in the band's order, the weight of (feature f, place j) stands at
f n + j. A row of place i in knot interval g then touches weights at (g + b) n + i + d, with b among the features that
are alive and d among the structure's offsets (of a chain -1, 0, 1). So one entry of all rows' local products, taken
over intervals and DOFs, is one contiguous piece of one diagonal of the band: no index is looked up, and no local block
is ever stored.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.equation_rows import CHUNK, EquationRows, RowPattern
from pinn_cli.training.band.row_sums import RowSums
from pinn_cli.training.band.subdomains import Subdomains


class TimeMajorSums(RowSums):
    """Sums of local features.

    Args:
        stride: Features that one knot interval moves on by: the outputs of a DOF.
        features: B, alive at once.
        count: Of one DOF in all.
        pattern: Of the rows.
    """

    def __init__(self, stride: int, features: int, count: int, pattern: RowPattern) -> None:
        self.stride, self.features, self.pattern, self.n = stride, features, pattern, len(pattern.coupled)
        self.size = count * self.n
        self.half_width = (features - 1) * self.n + pattern.reach
        # Entries more in front and behind: rows at the structure's ends add zeros there.
        self.margin = max(abs(offset) for offset in pattern.offsets)
        length = self.size + 2 * self.margin
        self._inside = slice(self.margin, self.margin + self.size)
        self._diagonals = {0: np.zeros(length)}  # those that something is added to
        self._gradient = np.zeros(length)
        self._length = length
        self._corner = np.zeros((pattern.count, pattern.count))
        self._slope = np.zeros(pattern.count)
        self.places = self._in_order(np.moveaxis(pattern.places, 0, -1))  # (kinds, F, n)
        self._touched = self._parameters_of_slots()

    @property
    def band(self) -> Diagonals:
        """See :attr:`RowSums.band`."""
        offsets = sorted(self._diagonals)
        return Diagonals(np.array(offsets), np.stack([self._diagonals[offset][self._inside] for offset in offsets]))

    def _diagonal(self, offset: int) -> np.ndarray:
        """(size and margins), a line of the band."""
        if offset not in self._diagonals:
            assert 0 <= offset <= self.half_width, "functions that one row feels stand within the band"
            self._diagonals[offset] = np.zeros(self._length)
        return self._diagonals[offset]

    @property
    def gradient(self) -> np.ndarray:
        """See :attr:`RowSums.gradient`."""
        return self._gradient[self._inside]

    @property
    def border(self) -> csr_matrix:
        """See :attr:`RowSums.border`; it keeps entries that happen to be zero, so that its pattern stays."""
        entries: list[tuple[np.ndarray, ...]] = []  # values, rows and columns
        first = np.arange(0, self.size, self.n)[:, None]
        for values, at, parameter in self._pulled():
            entries.append((values, first + at, np.broadcast_to(parameter, values.shape)))
        if "_dense_border" in self.__dict__:
            column, row = np.nonzero(self._dense_border[:, self._inside])
            entries.append((self._dense_border[column, row + self.margin], row, column))
        if not entries:
            return csr_matrix((self.size, self.pattern.count))
        values, row, column = (np.concatenate([x.reshape(-1) for x in part]) for part in zip(*entries, strict=True))
        return csr_matrix((values, (row, column)), shape=(self.size, self.pattern.count))

    def _pulled(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Of every line of single DOFs' equations of motion: values (groups, slots), their weights and parameters."""
        if "_pull" not in self.__dict__:
            return
        for lines, connections in zip(self._pull, self._touched, strict=True):
            for of_end, slots in zip(lines, connections, strict=True):
                for line, offset, (i, parameter) in zip(of_end, self.pattern.offsets, slots, strict=True):
                    yield line[self._inside].reshape(-1, self.n)[:, i], i + offset, parameter

    def dense_border(self, pick: np.ndarray) -> np.ndarray:
        """See :meth:`RowSums.dense_border`; in Fortran's order, without the indices of a sparse one."""
        out = np.zeros((len(pick), self.size // self.n, self.n))
        column = {place: i for i, place in enumerate(pick.tolist())}
        for values, at, parameter in self._pulled():
            for k, place in enumerate(parameter.tolist()):
                if place in column:
                    out[column[place], :, at[k]] += values[:, k]
        if "_dense_border" in self.__dict__:
            for place, i in column.items():
                out[i] += self._dense_border[place, self._inside].reshape(-1, self.n)
        return out.reshape(len(pick), self.size).T

    @cached_property
    def _dense_border(self) -> np.ndarray:
        """(places, size and margins), what does not come from the equations of motion of single DOFs."""
        return np.zeros((self.pattern.count, self._length))

    @cached_property
    def _pull(self) -> np.ndarray:
        """(kinds, F, D, size and margins), every parameter of a row against the weights in each of the row's slots.

        It stands at the row's own place, so that all rows are one contiguous piece.
        """
        kinds, ends, _ = self.places.shape
        return np.zeros((kinds, ends, len(self.pattern.offsets), self._length))

    @property
    def corner(self) -> np.ndarray:
        """See :attr:`RowSums.corner`."""
        return self._corner

    @property
    def slope(self) -> np.ndarray:
        """See :attr:`RowSums.slope`."""
        return self._slope

    def add_rows(
        self,
        segments: Segments,
        rows: EquationRows,
        residual: Tensor,
        weight: Tensor,
        averages: Subdomains | None = None,
    ) -> None:
        """See :meth:`RowSums.add_rows`."""
        table = self._table(segments, rows, residual, averages)  # (C, I, S, n)
        table *= np.broadcast_to(weight.cpu().numpy(), residual.shape) ** 0.5
        if averages is None:
            table *= segments.mask.cpu().numpy()[:, :, None]
        table = self._in_order(table)
        first = (segments.feature[:, 0] // self.stride).cpu().numpy()
        for start, stop in _runs(first):
            for sample in range(table.shape[2]):
                part = table[:, start:stop, sample]
                self._add_readout(part, int(first[start]))
                self._add_parameters(part, int(first[start]))

    def add_own_rows(self, segments: Segments, gram: Tensor, moment: Tensor, weight: Tensor) -> None:
        """See :meth:`RowSums.add_own_rows`."""
        first = (segments.feature[:, 0] // self.stride).cpu().numpy()
        products, moments, scale = gram.cpu().numpy(), *(self._in_order(x.cpu().numpy()) for x in (moment, weight))
        for start, stop in _runs(first):
            place = int(first[start]) * self.stride * self.n + self.margin
            for a in range(self.features):
                self._cells(self._gradient, place + a * self.n, stop - start)[...] += moments[start:stop, a] * scale
                for b in range(a + 1):
                    cells = self._cells(self._diagonal((a - b) * self.n), place + b * self.n, stop - start)
                    cells += products[start:stop, a, b, None] * scale

    def add_pair(self, segments: Segments, products: Tensor, first: int, second: int) -> None:
        """See :meth:`RowSums.add_pair`."""
        values, rank = products.cpu().numpy(), self.pattern.rank
        for group, start, length in self._placed(segments):
            for a in range(self.features):
                for b in range(self.features):
                    above, below = a * self.n + int(rank[first]), b * self.n + int(rank[second])
                    part = values[group : group + length, a, b]
                    if above >= below:
                        self._line(self._diagonal(above - below), start + below, length)[...] += part
                    if first != second and above < below:
                        self._line(self._diagonal(below - above), start + above, length)[...] += part

    def add_moment(self, segments: Segments, moment: Tensor, function: int) -> None:
        """See :meth:`RowSums.add_moment`."""
        values, rank = moment.cpu().numpy(), int(self.pattern.rank[function])
        for group, start, length in self._placed(segments):
            for a in range(self.features):
                line = self._line(self._gradient, start + a * self.n + rank, length)
                line += values[group : group + length, a]

    def add_border(self, segments: Segments, moment: Tensor, function: int, place: int) -> None:
        """See :meth:`RowSums.add_border`."""
        values, rank = moment.cpu().numpy(), int(self.pattern.rank[function])
        for group, start, length in self._placed(segments):
            for a in range(self.features):
                line = self._line(self._dense_border[place], start + a * self.n + rank, length)
                line += values[group : group + length, a]

    def _placed(self, segments: Segments) -> list[tuple[int, int, int]]:
        """Runs of groups whose features follow one another: first group, where its first weight stands, how many."""
        first = (segments.feature[:, 0] // self.stride).cpu().numpy()
        return [
            (start, int(first[start]) * self.stride * self.n + self.margin, stop - start)
            for start, stop in _runs(first)
        ]

    def _line(self, line: np.ndarray, start: int, groups: int) -> np.ndarray:
        """(groups,) view of a line from ``start`` on, one interval after the other."""
        step = self.stride * self.n
        return line[start : start + step * (groups - 1) + 1 : step]

    def _table(
        self, segments: Segments, rows: EquationRows, residual: Tensor, averages: Subdomains | None
    ) -> np.ndarray:
        """(C, I, S, n), columns: the features of the coupled DOFs, the parameters, the residual."""
        groups, samples, n = segments.displacement.shape[0], residual.shape[1], self.n
        slots, local = int(np.prod(rows.parameter.shape[-2:])), len(self.pattern.offsets) * self.features
        table = np.empty((local + slots + 1, groups, samples, n))
        table[-1] = residual.cpu().numpy()
        if averages is not None:
            table[local:-1] = averages(rows.parameter.flatten(2)).unflatten(2, (n, slots)).permute(3, 0, 1, 2).cpu()
            table[:local, :, 0] = rows.averaged_jacobian(segments, averages).permute(3, 1, 0, 2).flatten(0, 1).cpu()
            return table
        table[local:-1] = rows.parameter.flatten(3).permute(3, 0, 1, 2).cpu().numpy()
        chunk = max(1, CHUNK // segments.displacement.numel())
        for start in range(0, n, chunk):
            dofs = slice(start, min(start + chunk, n))
            table[:local, :, :, dofs] = rows.jacobian(segments, dofs).permute(3, 0, 2, 1).cpu().numpy()
        return table

    def _in_order(self, values: np.ndarray) -> np.ndarray:
        """Values (..., n) of the DOFs in the band's order."""
        return values if np.array_equal(self.pattern.order, np.arange(self.n)) else values[..., self.pattern.order]

    def _parameters_of_slots(self) -> list[list[list[tuple[np.ndarray, np.ndarray]]]]:
        """By kind, connection and slot: the rows that have both, and the parameters' places."""
        coupled = self._in_order(self.pattern.coupled.T)

        def both(ends: np.ndarray, slot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            rows = np.flatnonzero((ends >= 0) & slot)
            return rows, ends[rows]

        return [[[both(ends, slot) for slot in coupled] for ends in connections] for connections in self.places]

    def _offsets(self) -> list[int]:
        """Of every local weight of a row, from the weight of the row's own DOF and the first feature alive."""
        return [b * self.n + d for d in self.pattern.offsets for b in range(self.features)]

    def _cells(self, line: np.ndarray, start: int, groups: int) -> np.ndarray:
        """(groups, n) view of a line from ``start`` on, one interval after the other."""
        step, size = self.stride * self.n, line.itemsize
        return np.ndarray((groups, self.n), line.dtype, line, start * size, (step * size, size))

    @cached_property
    def _shared(self) -> list[list[np.ndarray | slice | None]]:
        """By slot and slot: the rows that use both, as an index where they are few; None where there are none."""
        coupled = self._in_order(self.pattern.coupled.T)

        def rows(both: np.ndarray) -> np.ndarray | slice | None:
            if not both.any():
                return None
            return slice(None) if 2 * int(both.sum()) > self.n else np.flatnonzero(both)

        return [[rows(one & other) for other in coupled] for one in coupled]

    def _add_readout(self, part: np.ndarray, first: int) -> None:
        """Products of the local weights' columns, and of each with the residual; ``part`` is (C, I, n)."""
        offsets, place, groups = self._offsets(), first * self.stride * self.n + self.margin, part.shape[1]
        for a, above in enumerate(offsets):
            column, shared = part[a], self._shared[a // self.features]
            self._cells(self._gradient, place + above, groups)[...] += column * part[-1]
            for b, below in enumerate(offsets):
                rows = shared[b // self.features]
                # Two columns at one offset, or further apart than the band is wide, are never in one row: one is zero.
                if rows is not None and (0 < above - below <= self.half_width or a == b):
                    cells = self._cells(self._diagonal(above - below), place + below, groups)
                    cells[:, rows] += column[:, rows] * part[b][:, rows]

    def _add_parameters(self, part: np.ndarray, first: int) -> None:
        """Products of the parameters' columns with everything, connection by connection of every row."""
        kinds, ends, n = self.places.shape
        if not kinds:
            return
        offsets, place = self._offsets(), first * self.stride * n + self.margin
        own = part[len(offsets) : -1].reshape(kinds, ends, *part.shape[1:])
        used = self.places >= 0
        for x in range(ends):
            sums = np.einsum("kin,in->kn", own[:, x], part[-1])
            np.add.at(self._slope, self.places[:, x][used[:, x]], sums[used[:, x]])
            for y in range(ends):
                products = np.einsum("kin,lin->kln", own[:, x], own[:, y])
                both = used[:, None, x] & used[None, :, y]
                of_row, of_column = self.places[:, None, x], self.places[None, :, y]
                row, column = (np.broadcast_to(at, both.shape)[both] for at in (of_row, of_column))
                np.add.at(self._corner, (row, column), products[both])
            for kind in range(kinds):
                for a, column in enumerate(part[: len(offsets)]):
                    slot, feature = divmod(a, self.features)
                    if len(self._touched[kind][x][slot][0]):
                        cells = self._cells(self._pull[kind, x, slot], place + feature * n, part.shape[1])
                        cells += own[kind, x] * column


def _runs(first: np.ndarray) -> list[tuple[int, int]]:
    """Ranges of groups whose first features follow one another."""
    breaks = np.flatnonzero(np.diff(first) != 1) + 1
    ends = [0, *breaks.tolist(), len(first)]
    return list(pairwise(ends))
