"""Multilayer perceptron: the paper's network, with its time derivatives carried forward."""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from pinn_cli.errors import InputError
from pinn_cli.legal_values import one_of, whole_number
from pinn_cli.network.activation import ACTIVATIONS, propagate
from pinn_cli.network.base import Continuity, Network, NetworkDesign
from pinn_cli.network.random_start import RandomStart
from pinn_cli.record.amplitudes import motion_amplitudes
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import record_band


class MlpNetwork(RandomStart, Network):
    """``depth`` hidden layers of ``width`` from time in [0, 1] to outputs in units of the record's amplitudes.

    Derivatives are carried forward through the layers (Taylor mode): a layer is one matrix product for the value and
    one for each derivative, whatever the number of outputs, where a reverse pass per output costs 2 ndof passes
    (paper, algorithm 1).

    Args:
        ndof: Number of DOFs.
        continuity: See :class:`Network`.
        depth, width: Hidden layers and units in each.
        activation: A name of :data:`pinn_cli.network.activation.ACTIVATIONS`.
        start, span: Time that becomes 0 and duration that becomes 1, s.
        amplitudes: Of the displacement, m, and velocity outputs, m/s.
        cycles: Periods of the record's highest frequency in ``span``, for networks that begin as sinusoids.
        dtype: Of weights and outputs.
    """

    amplitude: Tensor

    def __init__(
        self,
        ndof: int,
        continuity: Continuity,
        depth: int,
        width: int,
        activation: str,
        start: float,
        span: float,
        amplitudes: tuple[float, float],
        cycles: float,
        dtype: torch.dtype,
    ) -> None:
        super().__init__(ndof, continuity)
        self.activation, self.start, self.span, self.cycles = activation, start, span, cycles
        sizes = [1, *[width] * depth, self.channels * ndof]
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for inputs, outputs in pairwise(sizes):
            self.weights.append(torch.zeros(outputs, inputs, dtype=dtype))
            self.biases.append(torch.zeros(outputs, dtype=dtype))
        scale = torch.tensor(amplitudes[: self.channels], dtype=dtype)
        self.register_buffer("amplitude", scale.repeat_interleave(ndof))

    @torch.no_grad()
    def reset(self, seed: int) -> None:
        """See :meth:`RandomStart.reset`.

        Weights and biases are uniform within 1 / sqrt(inputs), as torch does it and the paper with it. The first layer
        of sines begins as random Fourier features instead: frequencies up to half the record's highest, since the
        layers behind it add harmonics (drawn from the whole band, the loss is three times higher after 600 steps).
        """
        generator = torch.Generator().manual_seed(seed)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            bounds = (1.0 / math.sqrt(weight.shape[1]),) * 2
            if layer == 0 and self.activation == "sine":
                bounds = (math.pi * self.cycles, math.pi)
            for tensor, bound in zip((weight, bias), bounds, strict=True):
                uniform = torch.rand(tensor.shape, generator=generator, dtype=torch.float64)
                tensor.copy_(bound * (2.0 * uniform - 1.0))

    def jet(self, time: Tensor, order: int) -> tuple[Tensor, ...]:
        """See :meth:`Network.jet`."""
        activation = ACTIVATIONS[self.activation]
        scaled = ((time - self.start) / self.span).to(self.amplitude.dtype)[:, None]
        jet = (scaled, torch.ones_like(scaled), torch.zeros_like(scaled))[: order + 1]
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            # A product for each derivative: on top of each other they would have to be copied together and apart.
            value, *rates = jet
            jet = (functional.linear(value, weight, bias), *(functional.linear(rate, weight) for rate in rates))
            jet = jet if layer == last else propagate(activation, jet)
        return tuple(self.amplitude / self.span**q * derivative for q, derivative in enumerate(jet))


class Mlp(NetworkDesign):
    """The paper's network; it is trained by gradients.

    Args:
        depth: Hidden layers.
        width: Units in each.
        activation: ``silu`` (paper, sparse recovery), ``tanh`` (paper, elsewhere) or ``sine``.
        continuity: See :class:`pinn_cli.network.base.Network`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "mlp"

    def __init__(
        self, depth: int = 4, width: int = 256, activation: str = "silu", continuity: Continuity = "penalised"
    ) -> None:
        self.depth = whole_number("network.depth", depth, least=1)
        self.width = whole_number("network.width", width, least=1)
        self.activation = one_of("network.activation", activation, tuple(ACTIVATIONS))
        if continuity not in ("exact", "penalised"):
            raise InputError("network.continuity", continuity, "exact or penalised")
        self.continuity: Continuity = continuity

    def build(self, record: Record, dtype: torch.dtype = torch.float64) -> MlpNetwork:
        """See :meth:`NetworkDesign.build`; its weights are drawn from seed 0 until :meth:`MlpNetwork.reset`."""
        amplitudes = motion_amplitudes(record)
        network = MlpNetwork(
            record.ndof,
            self.continuity,
            self.depth,
            self.width,
            self.activation,
            float(record.time[0]),
            record.duration,
            (amplitudes["displacement"], amplitudes["velocity"]),
            record_band(record) * record.duration,
            dtype,
        )
        network.reset(0)
        return network
