"""Standard deviations of every state at every time, from the Hessian of the most probable solution.

Where many rows take weights at the same distances from a first one, their variances come line by line: the covariance
of two weights at a fixed distance is one line of the inverse. So the rows of all groups are multiplied entry by entry
with pieces of lines, and no group's own covariance is made.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.system.quantities import GROUND
from pinn_cli.training.minimise import Point
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.bordered import BorderedFactor
from pinn_cli.training.normal_matrix.elimination import Diagonals

# Groups from which on lines are quicker than a covariance for each.
ENOUGH = 1000


def is_alike(position: np.ndarray) -> bool:
    """Whether there are many groups, and the weights (I, C) of each are at the same distances from its first one."""
    return len(position) >= ENOUGH and bool((position - position[:, :1] == position[0] - position[0, 0]).all())


def row_variance(
    inverse: Diagonals, carried: np.ndarray, position: np.ndarray, rows: np.ndarray, given: np.ndarray | None = None
) -> np.ndarray:
    """Variance of linear rows, (I, S).

    Args:
        inverse: Covariance of the weights with the parameters held.
        carried: (p, size), how the weights follow p independent unit parameters.
        position: (I, C), of the weights, see :func:`is_alike`.
        rows: (I, S, C), by the weights.
        given: (I, S, p), by the independent parameters, the weights held; None: 0.
    """
    columns = np.ascontiguousarray(rows.transpose(2, 1, 0))  # (C, S, I)
    first, offsets = _evenly(position[:, 0]), (position[0] - position[0, 0]).tolist()
    used = [c for c, column in enumerate(columns) if column.any()]
    out, inner, product = (np.zeros(columns.shape[1:]) for _ in range(3))
    for i, c in enumerate(used):
        inner[...] = 0.0
        for d in used[:i]:
            np.multiply(columns[d], _covariance(inverse, first, offsets[c], offsets[d]), out=product)
            inner += product
        inner *= 2.0
        np.multiply(columns[c], _covariance(inverse, first, offsets[c], offsets[c]), out=product)
        inner += product
        inner *= columns[c]
        out += inner
    for number, line in enumerate(carried):
        inner[...] = 0.0 if given is None else -given[..., number].T
        for c in used:
            np.multiply(columns[c], _piece(line, first, offsets[c]), out=product)
            inner += product
        out += np.square(inner, out=inner)
    return out.T


def _evenly(first: np.ndarray) -> np.ndarray | range:
    """The same places as a range where they are evenly spaced: pieces of lines are views then."""
    step = int(first[1] - first[0])
    return range(int(first[0]), int(first[-1]) + 1, step) if step > 0 and (np.diff(first) == step).all() else first


def _covariance(inverse: Diagonals, first: np.ndarray | range, row: int, column: int) -> np.ndarray:
    """(I,), of the weights at two distances from every first one."""
    line = int(inverse.lines(np.array([abs(row - column)]))[0])
    return _piece(inverse.values[line], first, min(row, column))


def _piece(line: np.ndarray, first: np.ndarray | range, offset: int) -> np.ndarray:
    """(I,), the entries of a line at a distance from every first one."""
    if isinstance(first, range):
        return line[first.start + offset : first.stop + offset : first.step]
    return line[first + offset]


# Intervals whose covariances of all functions are held at once.
INTERVALS_AT_ONCE = 64


class ReadoutPosterior:
    """Gaussian posterior of readout and parameters about a solution."""

    def __init__(self, equations: NormalEquations, point: Point, factor: BorderedFactor) -> None:
        self.equations, self.point, self.factor = equations, point, factor
        self.inverse = factor.readout.inverse()
        # With R R^T the parameters' covariance, parameters add |(P - J A^-1 B) R|^2 to a row's variance.
        root = np.linalg.cholesky(factor.corner_covariance)
        readout = factor.readout
        self.root = torch.as_tensor(root)
        self.carried = torch.as_tensor(readout.solved(np.zeros((readout.size, len(root))), root))  # A^-1 B R

    @cached_property
    def _carried_lines(self) -> np.ndarray:
        """(p, size), of :attr:`carried`."""
        return np.ascontiguousarray(self.carried.numpy().T)

    def sensed(self, segments: Segments) -> dict[str, Tensor]:
        """Standard deviation of what sensors of every quantity would show without noise, at the segments' times.

        Each (N, channels): of displacement, velocity and acceleration n, and of the ground where it moves.
        """
        dynamics = self.equations.dynamics
        functions = dict(zip(RESPONSE_QUANTITIES, self.functions(segments), strict=True))
        sensing = {quantity: dynamics.sensing(quantity) for quantity in RESPONSE_QUANTITIES}
        if dynamics.structure.is_modal:
            out = dict(zip(RESPONSE_QUANTITIES, self._of_modes(segments, list(sensing.values())), strict=True))
        else:
            out = {
                quantity: std[:, : dynamics.ndof]
                if dynamics.feels_coordinate(quantity)
                else self.combined(segments, sensing[quantity])
                for quantity, std in functions.items()
            }
        return out | ({GROUND: functions["displacement"][:, dynamics.ground]} if dynamics.inputs.ground else {})

    def _of_modes(self, segments: Segments, sensing: Sequence[Sequence[tuple[int, csr_matrix]]]) -> list[Tensor]:
        """Standard deviations as of :meth:`combined`, each (N, channels), where every channel feels all functions.

        The covariance of all functions is then taken from the band once for all channels.
        """
        local, kinds = self._columns(segments), segments.orders
        weights = [[(order, torch.as_tensor(w.toarray())) for order, w in parts] for parts in sensing]
        deviations: list[list[Tensor]] = [[] for _ in sensing]
        for start in range(0, len(local), INTERVALS_AT_ONCE):
            part = slice(start, start + INTERVALS_AT_ONCE)
            position = local[part].flatten(1)
            covariance = self._covariance(position)
            for out, parts in zip(deviations, weights, strict=True):
                rows = sum(w[:, None, :, None] * kinds[order][part, None, :, None] for order, w in parts)
                assert isinstance(rows, Tensor)
                rows = rows.flatten(3).flatten(1, 2)  # (intervals, channels S, functions B)
                out.append(_deviation(rows, covariance).unflatten(1, (len(parts[0][1]), -1)).mT)
        return [segments.scatter(torch.cat(out)) for out in deviations]

    def combined(self, segments: Segments, sensing: Sequence[tuple[int, csr_matrix]]) -> Tensor:
        """Standard deviation of weighted sums of functions and of their derivatives, (N, channels).

        Args:
            segments: Of the times.
            sensing: Orders of derivatives, and weights (channels, functions).
        """
        channels = sensing[0][1].shape[0]
        out = segments.mask.new_zeros((segments.samples, channels))
        for part in self._windows(segments):
            group, deviations = segments.part(part), []
            local, kinds = self._columns(group), group.orders
            for channel in range(channels):
                felt = [
                    (int(function), order, float(weight))
                    for order, weights in sensing
                    for function, weight in zip(weights[channel].indices, weights[channel].data, strict=True)
                ]
                position = torch.cat([local[:, function] for function, _, _ in felt], -1)
                rows = torch.cat([weight * kinds[order] for _, order, weight in felt], -1)
                deviations.append(self._spread(position, rows))
            group.place(torch.stack(deviations, -1), out)
        return out

    def functions(self, segments: Segments) -> list[Tensor]:
        """Standard deviation of every function and its two derivatives at the segments' times, each (N, functions)."""
        count = self.equations.layout.ndof
        out = [segments.mask.new_zeros((segments.samples, count)) for _ in RESPONSE_QUANTITIES]
        for part in self.equations.windows(segments):
            group = segments.part(part)
            local, rows = self._columns(group), torch.cat(group.orders, 1)
            by_function = [self._spread(local[:, i], rows).chunk(len(out), 1) for i in range(count)]
            for values, of_kind in zip(out, zip(*by_function, strict=True), strict=True):
                group.place(torch.stack(of_kind, -1), values)
        return out

    def _columns(self, segments: Segments) -> Tensor:
        """(I, functions, B), positions of the weights of every function."""
        return torch.as_tensor(self.equations.layout.columns(segments.feature, coupled=False))

    def force(self, segments: Segments) -> Tensor:
        """Standard deviation of the force that the estimated motion takes, at the segments' times, (N, n)."""
        parts = (
            torch.stack([self.deviation(*rows) for rows in self._rows_of_force(segments, part)], -1)
            for part in self._windows(segments)
        )
        return segments.scatter(torch.cat(list(parts)))

    def force_by_parameter(self, segments: Segments) -> Tensor:
        """Change of that force with each parameter, in prior standard deviations, the motion following: (N, n, p)."""
        solved, parts = torch.as_tensor(self.factor.readout.solved_border), []  # how the weights follow each parameter
        for part in self.equations.windows(segments):
            rows = self._rows_of_force(segments, part)
            parts.append(torch.stack([held - by_weight @ solved[position] for position, by_weight, held in rows], 2))
        return segments.scatter(torch.cat(parts))

    def _rows_of_force(self, segments: Segments, part: slice) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """DOF by DOF the linearised equation of motion in some groups of times, as :meth:`deviation` takes rows."""
        equations, group = self.equations, segments.part(part)
        rows = equations.motion.rows(segments, self.point, part)
        local = torch.as_tensor(equations.layout.columns(group.feature))
        for dof in range(equations.dynamics.ndof):
            felt = local[0, dof] >= 0  # in every group the same slots
            by_weight = rows.jacobian(group, slice(dof, dof + 1))[:, 0][..., felt]
            yield local[:, dof][:, felt], by_weight, equations.pattern.uncertain_columns(rows.parameter[:, :, dof], dof)

    def _windows(self, segments: Segments) -> list[slice]:
        """Groups whose rows and whose covariances of all coupled functions are held at once."""
        width = len(self.equations.pattern.offsets) * segments.feature.shape[1]
        return self.equations.windows(segments, width)

    def deviation(self, position: Tensor, jacobian: Tensor, held: Tensor) -> Tensor:
        """Standard deviation of linear rows, (I, S).

        Args:
            position: (I, C), of the readout weights that they take.
            jacobian: (I, S, C), the rows by those.
            held: (I, S, p), the rows by the parameters, in prior standard deviations.
        """
        columns = held.flatten(0, -2).any(0).nonzero()[:, 0]  # few parameters are in one row
        given = held[..., columns] @ self.root[columns]
        if is_alike(position.numpy()):
            return self._by_lines(position, jacobian, given)
        by_parameter = given - jacobian @ self.carried[position]
        return _deviation(jacobian, self._window(position), by_parameter)

    def _spread(self, position: Tensor, rows: Tensor) -> Tensor:
        """Standard deviation (I, S) of rows (I, S, C) by the weights at the given positions (I, C) alone."""
        if is_alike(position.numpy()):
            return self._by_lines(position, rows, None)
        return _deviation(rows, self._covariance(position))

    def _by_lines(self, position: Tensor, rows: Tensor, given: Tensor | None) -> Tensor:
        by_parameter = None if given is None else given.numpy()
        variance = row_variance(self.inverse, self._carried_lines, position.numpy(), rows.numpy(), by_parameter)
        return torch.as_tensor(variance).clamp(min=0).sqrt()

    def _covariance(self, position: Tensor) -> Tensor:
        """(I, C, C), of the weights at the given positions (I, C), with what the parameters add."""
        carried = self.carried[position]
        return self._window(position) + carried @ carried.mT

    def _window(self, position: Tensor) -> Tensor:
        """Entries (I, C, C) of the inverse at the given positions (I, C)."""
        place = position.numpy()
        return torch.as_tensor(self.inverse.at(place[:, :, None], place[:, None, :]))


def _deviation(rows: Tensor, covariance: Tensor, by_parameter: Tensor | None = None) -> Tensor:
    """Standard deviation of linear rows (..., C), from the weights' covariance and what parameters add (..., p)."""
    variance = ((rows @ covariance) * rows).sum(-1)
    if by_parameter is not None:
        variance = variance + by_parameter.square().sum(-1)
    return variance.clamp(min=0).sqrt()
