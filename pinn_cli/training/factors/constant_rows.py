"""Rows that never change: of what feels functions of time, or derivatives of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.normal_matrix.row_sums import RowSums


class ConstantRows:
    """Rows of several channels that feel functions alike.

    Args:
        segments: Features at their times.
        felt: What they feel: features (I, S, B), such as a derivative, and weights (channels, functions) of the
            functions that have them.
    """

    def __init__(self, segments: Segments, felt: Sequence[tuple[Tensor, csr_matrix]]) -> None:
        self.segments, self.felt = segments, [(features, csr_matrix(weights)) for features, weights in felt]

    @cached_property
    def _grams(self) -> list[list[np.ndarray]]:
        """(I, B, B), products of the features."""
        features = [phi for phi, _ in self.felt]
        return [[(one.mT @ other).cpu().numpy() for other in features] for one in features]

    def add_to(self, sums: RowSums, residual: Tensor, weight: Tensor, part: slice = slice(None)) -> None:
        """Add their weighted products.

        Args:
            sums: What they are added to.
            residual: (I, S, channels).
            weight: (channels,), 0 where there is none.
            part: Which groups the residual is of.
        """
        feature, by_channel = self.segments.feature[part], diags(weight.cpu().numpy())
        for (features, weights), grams in zip(self.felt, self._grams, strict=True):
            pulled = weights.T @ by_channel
            moment = (features[part].mT @ residual).cpu().numpy()  # (I, B, channels)
            sums.add_moment(feature, (moment.reshape(-1, moment.shape[-1]) @ pulled.T).reshape(*moment.shape[:2], -1))
            for (_, others), gram in zip(self.felt, grams, strict=True):
                sums.add_constant(feature, gram[part], pulled @ others)
