"""Rows of sensors that feel several functions of time: an accelerometer on a structure whose ground moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.sparse import csc_matrix, csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.system.quantities import MOTION
from pinn_cli.training.band.row_sums import RowSums


class SensorRows:
    """Constant rows of the sensors of one quantity.

    Args:
        segments: Features at the times of the observations.
        sensing: Orders of derivatives, and weights (channels, functions), see
            :meth:`pinn_cli.system.dynamics.Dynamics.sensing`.
        there: (channels,) bool, which sensors there are.
    """

    def __init__(self, segments: Segments, sensing: Sequence[tuple[int, csr_matrix]], there: np.ndarray) -> None:
        self.segments, self.channels = segments, np.flatnonzero(there)
        every = [(order, csc_matrix(weights[self.channels])) for order, weights in sensing]
        # What the sensors feel: derivatives of functions, each with its weight in every channel.
        self.felt = [(int(f), order) for order, weights in every for f in np.flatnonzero(np.diff(weights.indptr))]
        columns = [
            weights[:, f].toarray()[:, 0] for order, weights in every for f in np.flatnonzero(np.diff(weights.indptr))
        ]
        self.weights = np.stack(columns, axis=1)  # (channels there, felt)
        orders = sorted({order for order, _ in sensing})
        self.features = {order: getattr(segments, MOTION[order]) for order in orders}
        self.grams = {(a, b): self.features[a].mT @ self.features[b] for a in orders for b in orders}

    def add_to(self, sums: RowSums, residual: Tensor, weight: Tensor, part: slice = slice(None)) -> None:
        """Add their weighted products.

        Args:
            sums: What they are added to.
            residual: (I, S, channels).
            weight: (channels,).
            part: Which groups the residual is of.
        """
        scaled = self.weights * weight.cpu().numpy()[self.channels, None]
        products, pull = scaled.T @ self.weights, torch.as_tensor(scaled).to(residual)
        moments = {
            order: features[part].mT @ (residual[..., self.channels] @ pull)
            for order, features in self.features.items()
        }
        segments = self.segments.part(part)
        for i, (function, order) in enumerate(self.felt):
            sums.add_moment(segments, moments[order][..., i], function)
            for j, (other, other_order) in enumerate(self.felt[: i + 1]):
                if products[i, j]:
                    pair = self.grams[order, other_order][part] * products[i, j]
                    if function == other and order != other_order:  # two derivatives of one function
                        pair = pair + pair.mT
                    sums.add_pair(segments, pair, function, other)
