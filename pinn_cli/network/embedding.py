"""What an MLP gets for the time: the scaled time itself, or Fourier features of it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from pinn_cli.record.channels import record_band, slowest_motion
from pinn_cli.record.record import Record

EmbeddingName = Literal["none", "fourier"]
# Above 1, so that nothing need be periodic over the record.
PERIOD_MARGIN = 1.25
# Of the corner that an even spectrum would have: resonances below the band of a force hold more. With 1 they are held
# back (u by range 98.4 at 20 dB, and the 95 % band of u covers half); with a tenth training stalls at 10 dB.
RESONANCE_MARGIN = 0.3
# Springs that are not linear move the structure beyond the band in which sensors see it. Where features end with the
# band, parameters give way to what is missing beyond it: at 20 dB 9 of 18 intervals held the truth, here all.
BAND_MARGIN = 1.5
# More features than points would leave no residual that says how good the model is.
FEATURES_PER_POINT = 0.94


class Embedding(nn.Module, ABC):
    """Inputs of the first layer as functions of the scaled time s, which runs from 0 to 1 over the record.

    Attributes:
        count: Number of inputs.
    """

    count: int

    @abstractmethod
    def jet(self, scaled: Tensor, order: int) -> tuple[Tensor, ...]:
        """Inputs and their derivatives by s up to ``order`` (0, 1 or 2) at times (N,), each (N, count)."""


class ScaledTime(Embedding):
    """The scaled time itself."""

    count = 1

    def jet(self, scaled: Tensor, order: int) -> tuple[Tensor, ...]:
        """See :meth:`Embedding.jet`."""
        s = scaled[:, None]
        return (s, torch.ones_like(s), torch.zeros_like(s))[: order + 1]


class FourierFeatures(Embedding):
    """cos and sin of 2 pi j s / PERIOD_MARGIN, j = 1..harmonics, less of those of high frequency.

    Feature j has the amplitude 1 / (1 + (j / corner)^2), which is how a displacement falls off whose acceleration is
    even over the band. Without it a small loss may hide accelerations that are wrong between the points. The squares of
    all amplitudes add up to one.

    Args:
        harmonics: Frequencies.
        corner: Where the amplitudes begin to fall, in harmonics.
        dtype: Of the features.
    """

    omega: Tensor
    amplitude: Tensor

    def __init__(self, harmonics: int, corner: float, dtype: torch.dtype) -> None:
        super().__init__()
        self.count = 2 * harmonics
        j = torch.arange(1, harmonics + 1, dtype=torch.float64)
        amplitude = 1.0 / (1.0 + (j / corner).square())
        self.register_buffer("omega", (2.0 * math.pi / PERIOD_MARGIN * j).to(dtype))
        self.register_buffer("amplitude", (amplitude / amplitude.square().sum().sqrt()).to(dtype))

    def jet(self, scaled: Tensor, order: int) -> tuple[Tensor, ...]:
        """See :meth:`Embedding.jet`."""
        phase = scaled[:, None] * self.omega
        cosine, sine = self.amplitude * torch.cos(phase), self.amplitude * torch.sin(phase)
        # d/ds turns cos into -omega sin, and sin into omega cos.
        value = torch.cat((cosine, sine), -1)
        rate = torch.cat((-self.omega * sine, self.omega * cosine), -1)
        return (value, rate, -self.omega.repeat(2).square() * value)[: order + 1]


def embedding(name: EmbeddingName, record: Record, dtype: torch.dtype, points: int | None = None) -> Embedding:
    """The embedding of a record: its features go up to the record's band and fall off from where its motion does.

    Args:
        name: Which one.
        record: Measured.
        dtype: Of the features.
        points: At which residuals are compared and so many features told apart; up to ``BAND_MARGIN`` times the band is
            then followed.
    """
    if name == "none":
        return ScaledTime()
    period = PERIOD_MARGIN * record.duration
    wanted = max(4, math.ceil(record_band(record) * period))
    if points is not None:
        wanted = max(wanted, min(math.ceil(BAND_MARGIN * wanted), int(FEATURES_PER_POINT * points / 2.0)))
    harmonics = min(wanted, len(record.time) // 2)
    ratio = slowest_motion(record) * (period / (2.0 * math.pi)) ** 2
    return FourierFeatures(harmonics, RESONANCE_MARGIN * _corner(harmonics, ratio), dtype)


def _corner(harmonics: int, ratio: float) -> float:
    """The corner at which features of random phase have this ratio of rms acceleration to displacement.

    The ratio counts time in periods over 2 pi, so that harmonic j alone has j^2; it rises with the corner.
    """
    j = np.arange(1.0, harmonics + 1.0)
    corners = np.geomspace(1e-2, 10.0 * harmonics, 400)
    power = (1.0 + (j / corners[:, None]) ** 2) ** -2.0
    return float(np.interp(ratio**2, power @ j**4 / power.sum(1), corners))
