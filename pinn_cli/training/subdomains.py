"""Where the equation of motion is asked to hold: on the average over every knot interval, the subdomain method.

Enforced at every sample, a spline's equation of motion has far more residuals than the spline has weights, and what it
cannot follow is then a small force that never averages out: it passes for knowledge of the parameters. Averages over
the knot intervals are as many as there are weights to find, but for the two that start a motion; noise is averaged in
them, what the spline cannot follow cancels, and they are white where the residual is (Finlayson, The Method of Weighted
Residuals, 1972, section 1.2). The dynamic stiffness of a spline of even degree p is then off by the power p of
f / (r - f) at a frequency f, with r knots a second; for odd degrees averages would have to be taken about the knots.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments, in_groups

# Weights of a degree of freedom that no equation of motion settles: where it begins, and how fast.
INITIAL_CONDITIONS = 2
# Pieces of one interval at most, at the ends of a record.
MOST_PIECES = 3


class Subdomains:
    """Averages of a history over knot intervals, scaled so that white noise keeps its variance.

    There are as many as the features of a degree of freedom without its initial conditions: intervals at both ends are
    divided until that is so.

    Args:
        segments: Collocation points, grouped by knot interval.

    Attributes:
        segments: The same with a group for every average: I of them, of S points at most.
        interval: (I,), which knot interval each belongs to.
        weight: (I, S), of the points in the average of their group; 0 at padding.
    """

    def __init__(self, segments: Segments) -> None:
        points = segments.mask.sum(1).long()
        pieces = torch.tensor(_pieces(points.tolist(), segments.count - INITIAL_CONDITIONS))
        self.interval = torch.repeat_interleave(torch.arange(len(points)), pieces)
        first = torch.cumsum(pieces, 0) - pieces
        number = torch.arange(len(self.interval)) - first[self.interval]
        rank = torch.arange(segments.mask.shape[1])
        piece = rank * pieces[:, None] // points.clamp(min=1)[:, None]
        inside = (piece[self.interval] == number[:, None]) * segments.mask[self.interval]
        sample, feature, jet = (x[self.interval] for x in (segments.sample, segments.feature, segments.jet))
        jet = jet * inside[:, None, :, None]
        self.segments = replace(segments, sample=sample, mask=inside, feature=feature, jet=jet)
        self.points = inside.sum(1)
        self.weight = inside / self.points.sqrt()[:, None]

    def part(self, groups: slice) -> Subdomains:
        """Some of the averages alone."""
        out = copy(self)
        out.interval, out.weight, out.points = (x[groups] for x in (self.interval, self.weight, self.points))
        out.segments = self.segments.part(groups)
        return out

    def times(self, time: Tensor) -> np.ndarray:
        """(I,), the mean time of every average, s, of the times (N,) of its points."""
        total: Tensor = self.segments.gather(time).sum(1) / self.points.clamp(min=1)
        return total.numpy()

    def loosened(self, where: Tensor, factor: float) -> Subdomains:
        """The same with averages (I,) bool whose error is so many times that of the others: they count for less."""
        out = copy(self)
        out.weight = torch.where(where[:, None], self.weight / factor, self.weight)
        return out

    @property
    def count(self) -> int:
        """Averages in all."""
        return len(self.interval)

    def __call__(self, values: Tensor, groups: slice = slice(None)) -> Tensor:
        """Averages (I, ..., 1, C) of grouped histories (I, ..., S, C), times the square root of their points.

        The histories may be of some groups alone.
        """
        weight = self.weight[groups]
        return in_groups(weight.reshape(len(weight), *[1] * (values.ndim - 3), 1, -1), values)

    def by_interval(self, averages: Tensor) -> Tensor:
        """(intervals, n) averages over whole intervals, of (I, 1, n), in the order of time, scaled alike."""
        root, intervals = self.points.sqrt(), int(self.interval[-1]) + 1
        total = averages.new_zeros((intervals, averages.shape[-1]))
        total.index_add_(0, self.interval, averages[:, 0] * root[:, None])
        points = root.new_zeros(intervals).index_add_(0, self.interval, self.points)
        return total / points.sqrt()[:, None]


def _pieces(points: list[int], wanted: int) -> list[int]:
    """Pieces of every group: one where it has points, and more at either end until there are as many as wanted.

    Args:
        points: Of every group, in the order of time.
        wanted: Pieces in all.
    """
    pieces = [min(1, n) for n in points]
    lacking = max(0, wanted - sum(pieces))
    half = len(points) // 2
    first, last = range(half), range(len(points) - 1, half - 1, -1)
    for groups, share in ((first, lacking - lacking // 2), (last, lacking // 2)):
        rest = share
        for group in groups:
            more = max(0, min(rest, min(points[group], MOST_PIECES) - pieces[group]))
            pieces[group] += more
            rest -= more
    return pieces
