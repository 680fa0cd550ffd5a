"""Rows of sensors that feel several functions of time: an accelerometer on a structure whose ground moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.band.row_sums import RowSums

KINDS = ("displacement", "velocity", "acceleration")


class SensorRows:
    """Constant rows of the sensors of one quantity.

    Args:
        segments: Features at the times of the observations.
        sensing: Orders of derivatives, and weights (channels, functions), see
            :meth:`pinn_cli.system.dynamics.Dynamics.sensing`.
        there: (channels,) bool, which sensors there are.
    """

    def __init__(self, segments: Segments, sensing: Sequence[tuple[int, csr_matrix]], there: np.ndarray) -> None:
        self.segments = segments
        self.parts = [
            [
                (int(function), order, float(weight))
                for order, weights in sensing
                for function, weight in zip(weights[channel].indices, weights[channel].data, strict=True)
            ]
            for channel in np.flatnonzero(there)
        ]
        self.channels = np.flatnonzero(there)
        orders = sorted({order for order, _ in sensing})
        self.features = {order: getattr(segments, KINDS[order]) for order in orders}
        self.grams = {(a, b): self.features[a].mT @ self.features[b] for a in orders for b in orders}

    def add_to(self, sums: RowSums, residual: Tensor, weight: Tensor) -> None:
        """Add their weighted products.

        Args:
            sums: What they are added to.
            residual: (I, S, channels).
            weight: (channels,).
        """
        moments = {order: features.mT @ residual for order, features in self.features.items()}
        for channel, parts in zip(self.channels, self.parts, strict=True):
            scale = weight[channel]
            for number, (function, order, factor) in enumerate(parts):
                sums.add_moment(self.segments, moments[order][..., channel] * (factor * scale), function)
                for other, other_order, other_factor in parts[: number + 1]:
                    products = self.grams[order, other_order] * (factor * other_factor * scale)
                    if function == other and order != other_order:  # two derivatives of one function
                        products = products + products.mT
                    sums.add_pair(self.segments, products, function, other)
