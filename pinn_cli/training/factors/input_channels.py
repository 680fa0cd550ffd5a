"""Sensors of inputs that are functions to be found: a load cell, the accelerometer on the ground, a support's sensor.

Between its samples such an input does what a band-limited history does, and so does its sensor's error: neither has
anything above the Nyquist frequency. Compared at the samples alone, features finer than these would be free to follow
another input there, of which the structure would feel the part in its band (an alias), and no sensor anything. So an
input w is compared with the interpolated history y between the samples as well, through a filter B of second order,

    B(d/dt) (w - y) = white noise,    |B|^2 = 1 + (f / f_c)^4,    f_c a little above the Nyquist frequency.

Every point of the finer grid counts for its share of a sample, so that what is known of the input in its band is the
same in however many intervals it is enforced; an error above the band is as improbable as the filter makes it.

Features have two derivatives. Of a support whose velocity or acceleration is measured the first or both are spent, and
the filter is of first order, or none: an error above the band is then as probable as one within.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from scipy.ndimage import minimum_filter1d
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.network import States
from pinn_cli.record.between_samples import refined, refined_times
from pinn_cli.record.spectrum import noise_level
from pinn_cli.system.functions import FLAT
from pinn_cli.training.factors.channel_at_point import ChannelAtPoint, Part
from pinn_cli.training.factors.constant_channels import ConstantChannels, ConstantRows
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel

# Corner of the errors' filter over the Nyquist frequency.
CORNER = 1.2
# Samples from where the samples tell an input on, within which its derivatives are not told yet.
FROM_THE_END = 3


class InputChannels(ConstantChannels):
    """The sensors of one measured input; arguments as of :class:`ConstantChannels`.

    Attributes:
        time: (P,), s, of the points.
        points: Features there.
        segments: The same, as they count there.
        resolved: (P,), 1 where the samples tell the input, 0 near the ends.
        gain: Of the filter, which B is divided by.
    """

    def __init__(self, frame: Frame, quantity: str, mask: Tensor) -> None:
        super().__init__(frame, quantity, mask)
        record, network, refinement = frame.problem.record, frame.network, frame.refinement
        like = network.readout.detach()
        self.acting, self.per_sample = np.ones(len(self.present), bool), refinement
        self.time = torch.as_tensor(refined_times(record.time, refinement)).to(like)
        self.points = network.segments(self.time)
        corner = CORNER * math.pi / record.step
        ((order, matrix),) = frame.dynamics.sensing(quantity)
        factors = (1.0, 2.0 * FLAT / corner, corner**-2)[: 3 - order]
        # The noise is that of the samples in the band that the features follow: there |B|^2 is one on average.
        reach = min(1.0, network.free_intervals * record.step) / CORNER
        self.gain = (1.0, (1.0 + 2.0 * reach**2 / 3.0) ** 0.5, (1.0 + reach**4 / 5.0) ** 0.5)[2 - order]
        self.order = order
        weights = [csr_matrix(factor / self.gain * matrix) for factor in factors]
        self._weights = [torch.as_tensor(w.toarray().T).to(like) for w in weights]
        history = np.where(self.present, np.nan_to_num(record.histories(quantity)), 0.0)
        values, left_open = refined(history, refinement)
        noise = np.array([noise_level(column, record.step) for column in history.T])
        # At the ends of a record, where half of the neighbours are missing, they tell less than a sample does. There
        # the samples stand alone.
        near = 2 * FROM_THE_END * refinement + 1
        resolved = minimum_filter1d((left_open <= noise).all(axis=1), near, mode="constant", cval=False)
        target = self._filtered(torch.as_tensor(values).to(like), factors)
        alone = self.gain * refinement**0.5 * (np.arange(len(resolved)) % refinement == 0)
        of_value, of_rates = (
            torch.as_tensor(x).to(like) for x in (np.where(resolved, 1.0, alone), resolved.astype(float))
        )
        self.resolved = of_rates
        self.segments = self.points.weighted(*(of_value if k == order else of_rates for k in range(3)))
        plain = of_value[:, None] * torch.as_tensor(values).to(like) / self.gain
        self.target = self.segments.gather(torch.where(of_rates[:, None] > 0, target, plain))
        jet = self.segments.orders
        self.rows = ConstantRows(self.segments, list(zip(jet[order:], weights, strict=True)))

    def _filtered(self, values: Tensor, factors: Sequence[float]) -> Tensor:
        """(P, K), B applied: to as much as the features follow, the rest stays."""
        if len(factors) == 1:
            return values / self.gain
        points = self.points
        weights = FeatureProjection(self.frame.network, points).coefficients(values).to(values)[points.feature]
        rates = sum(factor * (phi @ weights) for factor, phi in zip(factors[1:], points.orders[1:], strict=False))
        assert isinstance(rates, Tensor)
        return (values + points.scatter(rates)) / self.gain

    def measurands(self, states: States) -> Tensor:
        """(..., K), what they feel, through the filter: white where the input is what was measured."""
        jet = (states.displacement, states.velocity, states.acceleration)
        return sum(x @ w for x, w in zip(jet[self.order :], self._weights, strict=True))  # type: ignore[return-value]

    @property
    def values(self) -> np.ndarray:
        """(K,); an input is compared between its samples too, where features finer than these follow it."""
        return np.maximum(self.samples, self.frame.network.count)

    def squares(self, point: Point) -> np.ndarray:
        """(K,), of what is left in the band of the samples."""
        residual = self.target.new_zeros((self.segments.samples, len(self.present)))
        for part in self.frame.windows(self.segments):
            self.segments.part(part).place(self.residual(point, part), residual)
        return self._in_band(residual)

    def squares_moved(self, point: Point, steps: Sequence[Point]) -> np.ndarray:
        """(K,), the same of what small steps move."""
        histories = (
            self._in_band(self.measurands(self.frame.flat_states(self.segments, step)) * self.mask) for step in steps
        )
        return np.sum(list(histories), axis=0)

    def _in_band(self, histories: Tensor) -> np.ndarray:
        return self.in_band(histories).square().sum(0).numpy() / self.per_sample

    def in_band(self, histories: Tensor) -> Tensor:
        """(P, K) histories at the points, as far as the sensors' samples follow them."""
        spectrum = torch.fft.rfft(histories, dim=0)
        spectrum[len(histories) // (2 * self.per_sample) + 1 :] = 0.0
        return torch.fft.irfft(spectrum, len(histories), dim=0)

    def at(self, point: Point, noise: NoiseModel) -> Iterator[ChannelAtPoint]:
        """See :meth:`Channels.at`."""
        points, record = self.points, self.frame.problem.record
        measurands = self.measurands(self.frame.flat_states(points, point)).numpy()
        residual = points.scatter(self.residual(point)).numpy()
        for i in np.flatnonzero(self.present).tolist():
            yield ChannelAtPoint(
                record.column(self.name, i).name,
                self.name,
                points,
                points.orders,
                [
                    Part(int(function), order, float(weight[function, i]))
                    for order, weight in enumerate(self._weights, start=self.order)
                    for function in np.flatnonzero(weight[:, i].numpy())
                ],
                measurands[:, i],
                None,
                residual[:, i],
                self.time.numpy(),
                float(noise.response[self.name][i]) * self.per_sample**0.5,
                counted=self.resolved.numpy(),
                per_sample=self.per_sample,
            )
