"""Networks with fixed features and a linear last layer, z(t) = Phi(t) W: residuals are nearly linear in W."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from pinn_cli.network.network import Continuity, Network


@dataclass(frozen=True, eq=False)
class Segments:
    """The features of one DOF at N times, grouped so that all times of a group share the same few features.

    A spline has one group per knot interval and few features in each; features that are alive everywhere form a single
    group. I groups, S times at most in each (padded), B features of one DOF in each.

    Attributes:
        sample: (I, S) long, index into the times; 0 at padding.
        mask: (I, S), 1 where there is a time, 0 at padding.
        feature: (I, B) long, which of the DOF's ``count`` features these are.
        jet: (I, 3, S, B), what each feature adds to displacement, velocity and acceleration; 0 at padding.
        continuity: (I, S, B), what it adds to d(displacement)/dt - velocity; None where that vanishes by construction.
        count: Features of one DOF in all, K.
        samples: Number of times, N.
    """

    sample: Tensor
    mask: Tensor
    feature: Tensor
    jet: Tensor
    continuity: Tensor | None
    count: int
    samples: int

    @property
    def orders(self) -> tuple[Tensor, Tensor, Tensor]:
        """(I, S, B) each, what each feature adds to displacement, velocity and acceleration."""
        displacement, velocity, acceleration = self.jet.unbind(1)
        return displacement, velocity, acceleration

    def gather(self, values: Tensor) -> Tensor:
        """(N, ...) to (I, S, ...), zero at padding."""
        mask = self.mask.reshape(*self.mask.shape, *[1] * (values.ndim - 1))
        return values[self.sample] * mask.to(values.dtype)

    def part(self, groups: slice) -> Segments:
        """Some of the groups alone."""
        arrays = ("sample", "mask", "feature", "jet")
        continuity = None if self.continuity is None else self.continuity[groups]
        return replace(self, continuity=continuity, **{name: getattr(self, name)[groups] for name in arrays})

    def weighted(self, *weights: Tensor) -> Segments:
        """The same with the values of features, and both derivatives, times weights of the times, (N,) of each."""
        gathered = torch.stack([self.gather(weight) for weight in weights], 1)
        return replace(self, jet=gathered[..., None] * self.jet)

    def scatter(self, grouped: Tensor) -> Tensor:
        """(I, S, ...) back to (N, ...)."""
        out = grouped.new_zeros((self.samples, *grouped.shape[2:]))
        self.place(grouped, out)
        return out

    def place(self, grouped: Tensor, out: Tensor) -> None:
        """Write (I, S, ...) where it belongs in (N, ...)."""
        alive = self.mask.reshape(-1) > 0
        out[self.sample.reshape(-1)[alive]] = grouped.reshape(-1, *grouped.shape[2:])[alive]


def in_groups(left: Tensor, right: Tensor) -> Tensor:
    """Products of groups (I, ..., R, B) and (I, ..., B, C): NumPy multiplies small matrices twice as fast as torch."""
    if left.requires_grad or right.requires_grad or left.device.type != "cpu":
        return left @ right
    return torch.from_numpy(left.numpy() @ right.numpy())


class LinearReadout(Network):
    """A network z(t) = Phi(t) W with fixed features Phi.

    Attributes:
        readout: W, (channels, count, ndof).
    """

    readout: nn.Parameter

    def __init__(self, ndof: int, continuity: Continuity, count: int, dtype: torch.dtype = torch.float64) -> None:
        super().__init__(ndof, continuity)
        self.count = count
        self.readout = nn.Parameter(torch.zeros(self.channels, count, ndof, dtype=dtype))

    @abstractmethod
    def groups(self, time: Tensor, order: int) -> tuple[Tensor, Tensor, Tensor, tuple[Tensor, ...]]:
        """Sample indices and mask (I, S), feature indices (I, B), and features and derivatives, each (I, S, B)."""

    @property
    @abstractmethod
    def free_intervals(self) -> float:
        """Independent values per second of the features, Hz; they follow frequencies up to half of it."""

    def segments(self, time: Tensor) -> Segments:
        """The features of the motion of one DOF at times (N,), s, for both kinds of continuity.

        With separate outputs for displacement and velocity a DOF has twice the features: output c's feature g is number
        2 g + c, so that features that are neighbours in time stay neighbours.
        """
        sample, mask, feature, jet = self.groups(time, 2)
        if self.channels == 1:
            return Segments(sample, mask, feature, torch.stack(jet, 1), None, self.count, len(time))
        value, rate = jet[:2]
        zero = torch.zeros_like(value)

        def interleave(first: Tensor, second: Tensor) -> Tensor:
            return torch.stack((first, second), -1).flatten(-2)

        return Segments(
            sample,
            mask,
            interleave(2 * feature, 2 * feature + 1),
            torch.stack((interleave(value, zero), interleave(zero, value), interleave(zero, rate)), 1),
            interleave(rate, -value),
            2 * self.count,
            len(time),
        )

    def jet(self, time: Tensor, order: int) -> tuple[Tensor, ...]:
        """See :meth:`Network.jet`."""
        sample, mask, feature, features = self.groups(time, order)
        shape = (len(time), self.channels * self.ndof)
        weights = self.readout.permute(1, 0, 2).flatten(1)[feature]  # (I, B, channels * ndof)
        alive = mask.reshape(-1) > 0
        where = sample.reshape(-1)[alive]
        outputs = []
        for phi in features:
            values = (phi @ weights).reshape(-1, shape[1])[alive]
            outputs.append(values.new_zeros(shape).index_copy(0, where, values))
        return tuple(outputs)
