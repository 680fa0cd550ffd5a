"""Readout weights in units of the record's amplitudes, so that one learning rate suits every record."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.record.channels import motion_amplitudes
from pinn_cli.record.record import Record

# The features that reach least, of which some lie at the ends of the record and are hardly seen, count as slow.
SLOW_FEATURES = 0.1


class _Scaled(nn.Module):
    """A weight as the product of a fixed scale and what is learned."""

    scale: Tensor

    def __init__(self, scale: Tensor) -> None:
        super().__init__()
        self.register_buffer("scale", scale)

    def forward(self, learned: Tensor) -> Tensor:
        """The weight."""
        return self.scale * learned

    def right_inverse(self, weight: Tensor) -> Tensor:
        """What to learn from."""
        return weight / self.scale


def scale_readout(network: LinearReadout, record: Record) -> None:
    """Have a network learn its readout weights in units of the record's amplitudes; ``readout`` becomes a product.

    The slow features of an output have its amplitude as their unit. Faster ones have less, in proportion to how far
    they drive displacement, velocity or acceleration: unscaled, Fourier features of high frequency throw the
    accelerations about at every step of a gradient method. The features of a spline are nearly all alike.
    """
    amplitudes = motion_amplitudes(record)
    reach = _reach(network, record, {**amplitudes, "continuity": amplitudes["velocity"]})
    slow = reach.quantile(SLOW_FEATURES, dim=1, keepdim=True)
    unit = torch.tensor([amplitudes["displacement"], amplitudes["velocity"]][: network.channels]).to(reach)
    scale = unit[:, None] * (slow / reach).clamp(max=1.0)
    parametrize.register_parametrization(network, "readout", _Scaled(scale[..., None]))


def _reach(network: LinearReadout, record: Record, amplitudes: Mapping[str, float]) -> Tensor:
    """(channels, count): the most that a weight of one adds to any part of the motion, over that part's amplitude."""
    segments = network.segments(torch.as_tensor(record.time).to(network.readout))
    reach = network.readout.new_zeros(segments.count)
    for name, amplitude in amplitudes.items():
        features = getattr(segments, name)
        if features is not None:
            peak = features.abs().amax(1) / amplitude
            reach.scatter_reduce_(0, segments.feature.flatten(), peak.flatten(), "amax")
    # What no sample sees is not slow.
    return torch.where(reach > 0, reach, reach.amax()).unflatten(0, (-1, network.channels)).T
