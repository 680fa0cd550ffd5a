"""One channel where a record is solved: what it feels, what is left of it, and what that is made of."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.normal_matrix.layout import BandLayout


class Part(NamedTuple):
    """Something of which a sum is made: a derivative of a function of time, times a factor.

    Attributes:
        function: Which.
        order: Of its derivative.
        weight: A number, or (I, S).
    """

    function: int
    order: int
    weight: Tensor | float


@dataclass(frozen=True, eq=False)
class ChannelAtPoint:
    """One channel at a point.

    Attributes:
        name: For people.
        quantity: That it measures.
        segments: Of its samples.
        features: Order of a derivative to features (I, S, B).
        parts: Of what it feels.
        measurand: (J,), what it feels.
        displacement: (J,), of its place; None: it has none.
        residual: (J,), estimated minus measured.
        time: (J,), s.
        sigma: Its noise at each of them.
        gain: Of what it shows over what it feels.
        uncertain: Kinds of its calibration that are parameters of the model already.
        parameters: Number of a parameter of the model to what that does to it (J,).
        counted: (J,), or a number: 0 where nothing is compared.
        per_sample: Times for each of its samples.
    """

    name: str
    quantity: str
    segments: Segments
    features: Mapping[int, Tensor]
    parts: list[Part]
    measurand: np.ndarray
    displacement: np.ndarray | None
    residual: np.ndarray
    time: np.ndarray
    sigma: float
    gain: float = 1.0
    uncertain: Collection[str] = ()
    parameters: Mapping[int, np.ndarray] = field(default_factory=dict)
    counted: np.ndarray | float = 1.0
    per_sample: int = 1

    def rows(self, layout: BandLayout) -> csr_matrix:
        """(I S, size), of what it shows by the readout weights."""
        feature = self.segments.feature.numpy()
        total = csr_matrix((self.segments.mask.numel(), layout.size))
        for function, order, weight in self.parts:
            phi = (weight[..., None] if isinstance(weight, Tensor) else weight) * self.features[order]
            places = layout.positions(feature, np.full_like(feature, function))
            total += sparse_rows(self.gain * phi, places, layout.size)
        return total

    def border(self, layout: BandLayout, columns: np.ndarray) -> np.ndarray:
        """(size, D), products of columns (J, D) with its own rows."""
        grouped = self.segments.gather(torch.as_tensor(columns).to(self.segments.mask))
        border: np.ndarray = self.rows(layout).T @ grouped.flatten(0, 1).numpy()
        return border

    def moved(self, layout: BandLayout, weights: np.ndarray) -> np.ndarray:
        """(J, W), change of what it shows with changes of the readout weights (size, W)."""
        grouped = torch.as_tensor(self.rows(layout) @ weights).unflatten(0, self.segments.mask.shape)
        return self.segments.scatter(grouped).numpy()


def sparse_rows(blocks: Tensor, places: np.ndarray, size: int) -> csr_matrix:
    """Blocks (I, S, C) as rows (I S, size); places (I, C), -1 where there is nothing."""
    groups, samples = blocks.shape[:2]
    places = np.broadcast_to(places[:, None], blocks.shape)
    used = places >= 0
    starts = np.concatenate(([0], np.cumsum(used.sum(-1))))
    return csr_matrix((blocks.numpy()[used], places[used], starts), (groups * samples, size))
