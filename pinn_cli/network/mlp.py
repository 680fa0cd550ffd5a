"""Multilayer perceptron: the paper's network, with its time derivatives carried forward.

It gets the scaled time itself, as in the paper, or Fourier features of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Annotated, Literal, get_args

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from pinn_cli.network.activation import ACTIVATIONS, propagate
from pinn_cli.network.network import CONTINUITIES, Continuity, Network, NetworkDesign
from pinn_cli.record.channels import motion_amplitudes, record_band, slowest_motion
from pinn_cli.record.record import Record
from pinn_cli.settings.legal_values import one_of, whole_number

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
# Readout weights of an embedded network, over one by the square root of the width. Hidden units that need move only a
# little stay where they are nearly linear, so that Gauss-Newton steps reach far: with 16 it takes twice as many.
EMBEDDED_READOUT = 200.0
# Spread of the first weights of an embedded network, whose inputs have one as the sum of their mean squares.
EMBEDDED_INPUT = 0.001
# Times that and over that in a network which is solved for all its weights: with 1 it takes three times as many steps,
# with 30 a step reaches the loss that it promises. A gradient method would not get along with such unequal scales.
LINEAR_GAIN = 30.0
# The list of layers takes memory before anything else does.
MOST_LAYERS = 1000
# Units of a hidden layer by default: motions of many DOFs do not pass through few units.
LEAST_WIDTH, UNITS_PER_DOF = 20, 3


class ScaledTime(nn.Module):
    """The scaled time s itself, which runs from 0 to 1 over the record, as what the first layer gets.

    Attributes:
        count: Number of inputs.
    """

    count = 1

    def jet(self, scaled: Tensor, order: int) -> tuple[Tensor, ...]:
        """Inputs and their derivatives by s up to ``order`` (0, 1 or 2) at times (N,), each (N, count)."""
        s = scaled[:, None]
        return (s, torch.ones_like(s), torch.zeros_like(s))[: order + 1]


class FourierFeatures(nn.Module):
    """cos and sin of 2 pi j s / PERIOD_MARGIN, j = 1..harmonics, less of those of high frequency.

    Feature j has the amplitude 1 / (1 + (j / corner)^2), which is how a displacement falls off whose acceleration is
    even over the band. Without it a small loss may hide accelerations that are wrong between the points. The squares of
    all amplitudes add up to one.
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
        """See :meth:`ScaledTime.jet`."""
        phase = scaled[:, None] * self.omega
        cosine, sine = self.amplitude * torch.cos(phase), self.amplitude * torch.sin(phase)
        # d/ds turns cos into -omega sin, and sin into omega cos.
        value = torch.cat((cosine, sine), -1)
        rate = torch.cat((-self.omega * sine, self.omega * cosine), -1)
        return (value, rate, -self.omega.repeat(2).square() * value)[: order + 1]


Embedding = ScaledTime | FourierFeatures


def embedding(name: EmbeddingName, record: Record, dtype: torch.dtype, points: int | None = None) -> Embedding:
    """The embedding of a record: its features go up to the record's band and fall off from where its motion does.

    At so many points residuals are compared and so many features told apart; up to ``BAND_MARGIN`` times the band is
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


class MlpNetwork(Network):
    """``depth`` hidden layers of ``width`` from an embedding of time to outputs in units of the record's amplitudes.

    Derivatives are carried forward through the layers (Taylor mode): a layer is one matrix product for the value and
    one for each derivative, whatever the number of outputs, where a reverse pass per output costs 2 ndof passes
    (paper, algorithm 1).

    Args:
        design: Depth, width, activation and continuity.
        record: Which scales time and outputs, and has the band of networks that begin as sinusoids.
        inputs: What the first layer gets.
        width: Of the hidden layers.
        functions: Unknown functions of time.
        dtype: Of weights and outputs.

    Attributes:
        start, span: Time that becomes 0 and duration that becomes 1, s.
        cycles: Periods of the record's highest frequency in ``span``.
        amplitude: Of every output, m and m/s.
    """

    amplitude: Tensor

    def __init__(
        self, design: Mlp, record: Record, inputs: Embedding, width: int, functions: int, dtype: torch.dtype
    ) -> None:
        super().__init__(functions, design.continuity)
        self.activation, self.start, self.span = design.activation, float(record.time[0]), record.duration
        self.cycles, self.inputs = record_band(record) * record.duration, inputs
        sizes = [inputs.count, *[width] * design.depth, self.channels * functions]
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for fan_in, fan_out in pairwise(sizes):
            self.weights.append(torch.zeros(fan_out, fan_in, dtype=dtype))
            self.biases.append(torch.zeros(fan_out, dtype=dtype))
        amplitudes = motion_amplitudes(record)
        scale = torch.tensor([amplitudes["displacement"], amplitudes["velocity"]][: self.channels], dtype=dtype)
        self.register_buffer("amplitude", scale.repeat_interleave(functions))

    @torch.no_grad()
    def reset(self, seed: int) -> None:
        """See :meth:`Network.reset`.

        Weights and biases are uniform within 1 / sqrt(inputs), as torch does it and the paper with it. The first layer
        of sines begins as random Fourier features instead: frequencies up to half the record's highest, since the
        layers behind it add harmonics (drawn from the whole band, the loss is three times higher after 600 steps).
        A network behind Fourier features starts at rest and nearly linear, see :meth:`_reset_embedded`.
        """
        generator = torch.Generator().manual_seed(seed)
        if self.inputs.count > 1:
            self._reset_embedded(generator)
            return
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            bounds = (1.0 / math.sqrt(weight.shape[1]),) * 2
            if layer == 0 and self.activation == "sine":
                bounds = (math.pi * self.cycles, math.pi)
            for tensor, bound in zip((weight, bias), bounds, strict=True):
                uniform = torch.rand(tensor.shape, generator=generator, dtype=torch.float64)
                tensor.copy_(bound * (2.0 * uniform - 1.0))

    def _reset_embedded(self, generator: torch.Generator) -> None:
        """Normal weights, phases all around the circle, and a last bias that has the motion begin around zero."""
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            normal = torch.randn(weight.shape, generator=generator, dtype=torch.float64)
            uniform = torch.rand(bias.shape, generator=generator, dtype=torch.float64)
            spread = 1.0 / math.sqrt(weight.shape[1])
            spread = EMBEDDED_INPUT if layer == 0 else spread * (EMBEDDED_READOUT if layer == last else 1.0)
            weight.copy_(spread * normal)
            bias.copy_(math.pi * (2.0 * uniform - 1.0))
        self._begin_around_zero()

    @torch.no_grad()
    def make_nearly_linear(self) -> float:
        """Of an embedded network at its start, for a training that solves for all weights.

        The outputs' slopes by what the first layer gives become orthogonal, so that no motion is more probable than
        another for the numbers that were drawn.

        Returns:
            How many times larger the readout is now; 1, having done nothing, where there is no embedding.
        """
        readout = self.weights[-1]
        if self.inputs.count == 1:
            return 1.0
        self.weights[0].div_(LINEAR_GAIN)
        if readout.shape[0] <= readout.shape[1]:
            orthogonal, _ = torch.linalg.qr(readout.T)
            readout.copy_(EMBEDDED_READOUT * orthogonal.T)
            slopes = self.mean_slopes(self._times())[0][0]
            half, failed = torch.linalg.cholesky_ex(slopes @ slopes.T)
            if not int(failed):
                # As large as they were in the mean, so that weights are as probable as they were.
                size = slopes.square().sum(1).mean().sqrt()
                readout.copy_(size * torch.linalg.solve_triangular(half, readout, upper=False))
        readout.mul_(LINEAR_GAIN)
        self._begin_around_zero()
        return LINEAR_GAIN

    def _begin_around_zero(self) -> None:
        self.biases[-1].zero_()
        self.biases[-1].sub_(self.jet(self._times(), 0)[0].mean(0) / self.amplitude)

    def _times(self) -> Tensor:
        """(64,), s, over the record."""
        return self.start + self.span * torch.linspace(0.0, 1.0, 64, dtype=torch.float64).to(self.amplitude)

    @torch.no_grad()
    def mean_slopes(self, time: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """How the outputs depend on each layer as long as the slopes of its activation stay at their means.

        Args:
            time: (P,), s, over which means are taken.

        Returns:
            By layer, (outputs, width), the outputs' derivative by what it gives before its activation, in units of
            ``amplitude``; and (fan in,), the mean of what it gets.
        """
        activation, value = ACTIVATIONS[self.activation], self.input_jet(time, 0)[0]
        means, rates = [], []
        for weight, bias in zip(self.weights, self.biases, strict=True):
            means.append(value.mean(0))
            value, rate = islice(activation(functional.linear(value, weight, bias)), 2)
            rates.append(rate.mean(0))
        slopes = [torch.eye(len(self.weights[-1])).to(value)]
        for weight, rate in zip(list(self.weights)[:0:-1], rates[-2::-1], strict=True):
            slopes.append((slopes[-1] @ weight) * rate)
        return slopes[::-1], means

    def input_jet(self, time: Tensor, order: int) -> tuple[Tensor, ...]:
        """What the first layer gets at times (N,), s, and its derivatives by time over ``span``, (N, inputs) each."""
        return self.inputs.jet(((time - self.start) / self.span).to(self.amplitude.dtype), order)

    def jet(self, time: Tensor, order: int) -> tuple[Tensor, ...]:
        """See :meth:`Network.jet`."""
        activation = ACTIVATIONS[self.activation]
        jet = self.input_jet(time, order)
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            # A product for each derivative: on top of each other they would have to be copied together and apart.
            value, *rates = jet
            jet = (functional.linear(value, weight, bias), *(functional.linear(rate, weight) for rate in rates))
            jet = jet if layer == last else propagate(activation, jet)
        return tuple(self.amplitude / self.span**q * derivative for q, derivative in enumerate(jet))


@dataclass(frozen=True)
class Mlp(NetworkDesign):
    """The paper's network, or a small one behind Fourier features, which trains better.

    Attributes:
        depth: Hidden layers.
        width: Units in each; None: ``LEAST_WIDTH``, or ``UNITS_PER_DOF`` for each DOF where that is more.
        activation: ``silu`` (paper, sparse recovery), ``tanh`` (paper, elsewhere) or ``sine``.
        embedding: What the first layer gets: the time (``none``, paper), or Fourier features of it over the record's
            band (``fourier``).
        continuity: See :class:`pinn_cli.network.network.Network`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "mlp"

    depth: int = 4
    width: int | None = 256
    activation: Annotated[str, tuple(ACTIVATIONS)] = "silu"
    continuity: Continuity = "penalised"
    embedding: EmbeddingName = "none"

    def __post_init__(self) -> None:
        whole_number("network.depth", self.depth, least=1, most=MOST_LAYERS)
        if self.width is not None:
            whole_number("network.width", self.width, least=1)
        one_of("network.activation", self.activation, tuple(ACTIVATIONS))
        one_of("network.continuity", self.continuity, CONTINUITIES)
        one_of("network.embedding", self.embedding, get_args(EmbeddingName))

    def build(
        self,
        record: Record,
        dtype: torch.dtype = torch.float64,
        functions: int | None = None,
        points: int | None = None,
    ) -> MlpNetwork:
        """See :meth:`NetworkDesign.build`; its weights are drawn from seed 0 until :meth:`MlpNetwork.reset`.

        Residuals are compared at so many points, see :func:`embedding`; None: wherever it takes.
        """
        width = max(LEAST_WIDTH, UNITS_PER_DOF * record.ndof) if self.width is None else self.width
        inputs = embedding(self.embedding, record, dtype, points)
        network = MlpNetwork(self, record, inputs, width, functions or record.ndof, dtype)
        network.reset(0)
        return network
