"""Fourier network: sines and cosines over the band of the record, linear readout."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.network import CONTINUITIES, Continuity, NetworkDesign
from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_finite_number, one_of, positive_number, whole_number


class FourierNetwork(LinearReadout):
    """1, t, and cos and sin of 2 pi j t / period for j = 1..harmonics, t from ``start``, s."""

    def __init__(
        self,
        ndof: int,
        start: float,
        span: float,
        period: float,
        harmonics: int,
        continuity: Continuity,
        dtype: torch.dtype,
    ) -> None:
        super().__init__(ndof, continuity, 2 + 2 * harmonics, dtype)
        self.start, self.span, self.period, self.harmonics = start, span, period, harmonics

    @property
    def free_intervals(self) -> float:
        """See :meth:`LinearReadout.free_intervals`."""
        return 2.0 * self.harmonics / self.period

    def groups(self, time: Tensor, order: int) -> tuple[Tensor, Tensor, Tensor, tuple[Tensor, ...]]:
        """See :meth:`LinearReadout.groups`: one group that holds every time and every feature."""
        t = time - self.start
        omega = 2.0 * math.pi / self.period * torch.arange(1, self.harmonics + 1, dtype=time.dtype, device=time.device)
        phase = t[:, None] * omega
        features = []
        for q in range(order + 1):
            # d/dt turns cos(x) into omega cos(x + pi/2), and sin likewise.
            wave = omega**q * torch.cos(phase + q * math.pi / 2), omega**q * torch.sin(phase + q * math.pi / 2)
            constant, slope = (torch.full_like(t, float(q == order)) for order in (0, 1))
            trend = constant, (t if q == 0 else slope) / self.span
            features.append(torch.cat((torch.stack(trend, -1), *wave), -1)[None])
        sample = torch.arange(len(time), device=time.device)[None]
        mask = torch.ones(1, len(time), dtype=time.dtype, device=time.device)
        return sample, mask, torch.arange(self.count, device=time.device)[None], tuple(features)


@dataclass(frozen=True)
class Fourier(NetworkDesign):
    """Fourier features up to a multiple of the record's band.

    Attributes:
        band_margin: Highest feature frequency over the highest frequency that stands out of the noise in any channel;
            hidden DOFs and higher harmonics of a nonlinearity lie beyond what the sensors show.
        period_margin: Period over the record's length; above 1 so that nothing need be periodic.
        harmonics: Number of harmonics; None: chosen by the margins.
        continuity: See :class:`pinn_cli.network.network.Network`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "fourier"

    band_margin: float = 1.5
    period_margin: float = 1.25
    harmonics: int | None = None
    continuity: Continuity = "exact"

    def __post_init__(self) -> None:
        positive_number("network.band_margin", self.band_margin)
        if not is_finite_number(self.period_margin) or self.period_margin < 1:
            raise InputError("network.period_margin", self.period_margin, "a number >= 1")
        if self.harmonics is not None:
            whole_number("network.harmonics", self.harmonics, least=1)
        one_of("network.continuity", self.continuity, CONTINUITIES)

    def build(self, record: Record, dtype: torch.dtype = torch.float64, functions: int | None = None) -> FourierNetwork:
        """See :meth:`NetworkDesign.build`."""
        span = record.duration + 2 * record.step
        period = self.period_margin * span
        harmonics = self.harmonics or max(4, math.ceil(self.band_margin * record_band(record) * period))
        harmonics = min(harmonics, len(record.time) // 2 - 2)
        start, outputs = float(record.time[0]) - record.step, functions or record.ndof
        return FourierNetwork(outputs, start, span, period, harmonics, self.continuity, dtype)
