"""The equation of a sensor's high-pass filter: p^(order) + ... + a_0 p = x, of which the sensor shows p^(order).

The state p is a function of time as the motion is, and x is what the sensor feels. The equation holds on the average
over every knot interval, as the equation of motion does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.record.gauge import filter_polynomial
from pinn_cli.system.quantities import HIGH_PASS, TILT
from pinn_cli.training.band.gauge_rows import GaugeRows, add_products, summed_features
from pinn_cli.training.band.row_sums import RowSums
from pinn_cli.training.band.subdomains import Subdomains

# What the equation may leave, over the rms of the channel: less than any sensor's noise.
EXACT = 1e-4


class FilterRows:
    """Rows of one gauge's filter.

    Args:
        rows: Of the gauge, which has a state.
        segments: Of the collocation points.
        averages: Over the knot intervals; None: it holds at every point.
    """

    def __init__(self, rows: GaugeRows, segments: Segments, averages: Subdomains | None) -> None:
        self.rows, self.order = rows, rows.gauge.filter_order
        own = (segments.displacement, segments.velocity, segments.acceleration)
        self.segments, self.features = segments, own if averages is None else tuple(averages(phi) for phi in own)
        rms = float(np.sqrt(np.mean((rows.gauge.values - np.mean(rows.gauge.values)) ** 2))) or 1.0
        self.weight = (EXACT * rms) ** -2

    def residual(self, unknowns: Tensor, parameters: Mapping[str, Tensor]) -> Tensor:
        """(I, 1), or (I, S) at points, what the state asks for less what is felt."""
        return self._value(unknowns, self._parts(parameters))

    def add_to(self, sums: RowSums, unknowns: Tensor, parameters: Mapping[str, Tensor], spread: Tensor) -> None:
        """Add the weighted products of the rows at a point; see :meth:`GaugeRows.add_to`."""
        parts, state, places = self._parts(parameters), self.rows.state, self.rows.places
        assert state is not None
        by_kind = {TILT: [(f, order, -w) for f, order, w in self.rows.turning]}
        corner = self._corner(parameters)
        slope = (1.0,) if self.order == 1 else (2.0 * corner, math.sqrt(2.0))
        by_kind[HIGH_PASS] = [(state, order, 2.0 * math.pi * by) for order, by in enumerate(slope)]
        columns = {
            places[kind]: spread[places[kind]] * self._value(unknowns, by)
            for kind, by in by_kind.items()
            if kind in places
        }
        features = summed_features(parts, self.features.__getitem__)
        add_products(sums, self.segments, features, self._value(unknowns, parts), columns, self.weight)

    def _corner(self, parameters: Mapping[str, Tensor]) -> float:
        return 2.0 * math.pi * float(self.rows.value(HIGH_PASS, parameters))

    def _parts(self, parameters: Mapping[str, Tensor]) -> list[tuple[int, int, Tensor | float]]:
        state = self.rows.state
        assert state is not None
        own = enumerate(filter_polynomial(self._corner(parameters), self.order))
        felt = self.rows.parts(parameters)
        return [*((state, order, a) for order, a in own), *((f, order, -w) for f, order, w in felt)]

    def _value(self, unknowns: Tensor, parts: list[tuple[int, int, Tensor | float]]) -> Tensor:
        local = self.rows.layout.weights(unknowns)[self.segments.feature]
        every = (w * (self.features[order] @ local[..., function, None])[..., 0] for function, order, w in parts)
        return sum(every, local.new_zeros(self.features[0].shape[:2]))
