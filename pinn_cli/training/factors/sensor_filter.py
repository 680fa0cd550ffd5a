"""The equation of a sensor's high-pass filter: p^(order) + ... + a_0 p = x, of which the sensor shows p^(order).

The state p is a function of time as the motion is, and x is what the sensor feels. The equation holds on the average
over every knot interval, as the equation of motion does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from torch import Tensor

from pinn_cli.record.gauge import filter_polynomial
from pinn_cli.system.functions import Jet
from pinn_cli.system.quantities import HIGH_PASS
from pinn_cli.training.factors.calibrated_channels import CalibratedChannel, add_products, summed_features
from pinn_cli.training.factors.channel_at_point import Part
from pinn_cli.training.factors.factor import Factor
from pinn_cli.training.factors.feels import WeightedSum
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.point import Point

# What the equation may leave, over the rms of the channel: less than any sensor's noise.
EXACT = 1e-4


class SensorFilter(Factor):
    """That of one channel.

    Args:
        frame: Of the record.
        channel: Which has a state.
        state: The function that is.
    """

    name = "filter"

    def __init__(self, frame: Frame, channel: CalibratedChannel, state: int) -> None:
        super().__init__(frame)
        self.channel, self.state, self.order = channel, state, channel.gauge.filter_order
        self.segments, averages = frame.physics, frame.averages
        own = (self.segments.displacement, self.segments.velocity, self.segments.acceleration)
        self.features = own if averages is None else tuple(averages(phi) for phi in own)
        values = channel.gauge.values
        self.weight = (EXACT * (float(np.std(values)) or 1.0)) ** -2

    def _corner(self, parameters: Mapping[str, Tensor]) -> float:
        return 2.0 * math.pi * float(self.channel.value(HIGH_PASS, parameters))

    def _jet(self, point: Point) -> Jet:
        """Functions at the points, or their averages."""
        local = self.frame.layout.weights(point.unknowns)[self.segments.feature]
        return Jet(*(phi @ local for phi in self.features))

    def _state(self, parameters: Mapping[str, Tensor]) -> list[Part]:
        """What the state asks for."""
        polynomial = filter_polynomial(self._corner(parameters), self.order)
        return [Part(self.state, order, a) for order, a in enumerate(polynomial)]

    def residual(self, point: Point) -> Tensor:
        """(I, 1), or (I, S) at points, what the state asks for less what is felt."""
        return self._left(self._jet(point), self.frame.parameters(point))

    def _left(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        asked = WeightedSum(self._state(parameters)).value(jet, parameters)
        return asked - self.channel.feels.value(jet, parameters)

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """See :meth:`Factor.loss`."""
        return self.weight * float(self.residual(point).square().sum())

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        jet, parameters, spread = self._jet(point), self.frame.parameters(point), self.frame.spread_by_place
        felt, by = self.channel.feels.linearised(jet, parameters)
        parts = self._state(parameters) + [Part(f, order, -w) for f, order, w in felt]
        by, corner = {place: -column for place, column in by.items()}, self._corner(parameters)
        if HIGH_PASS in self.channel.places:
            slope = (1.0,) if self.order == 1 else (2.0 * corner, math.sqrt(2.0))
            of_state = WeightedSum([Part(self.state, order, 2.0 * math.pi * a) for order, a in enumerate(slope)])
            by[self.channel.places[HIGH_PASS]] = of_state.value(jet, parameters)
        columns = {place: spread[place] * column for place, column in by.items()}
        features = summed_features(parts, self.features.__getitem__)
        add_products(sums, self.segments, features, self._left(jet, parameters), columns, self.weight)
