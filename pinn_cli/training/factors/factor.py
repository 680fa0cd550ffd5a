"""A factor: something that is said of the unknowns (Dellaert and Kaess 2017), by residuals and their linearised rows.

Every loop over what a record says is a loop over its factors, and asks none of them what it is.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.training.factors.channel_at_point import ChannelAtPoint
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.sensor_samples import SensorSamples


class Factor(ABC):
    """Residuals of one kind.

    Args:
        frame: Of the record.

    Attributes:
        name: What its loss is called; factors of one name add up.
    """

    name: str

    def __init__(self, frame: Frame) -> None:
        self.frame = frame

    @abstractmethod
    def loss(self, point: Point, noise: NoiseModel) -> float:
        """Weighted sum of squares, or what else adds to twice the negative log density."""

    @abstractmethod
    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """Add the weighted products of its rows with each other and with the residuals."""


class Residuals(Factor):
    """Residuals of K channels or equations at the times of some segments, (I, S, K), 0 at padding."""

    segments: Segments

    @abstractmethod
    def residual(self, point: Point, part: slice) -> Tensor:
        """Of some groups."""

    @abstractmethod
    def weight(self, noise: NoiseModel) -> Tensor:
        """One over the variance, 0 where nothing is said: (K,), or (I, S, K) where it varies."""

    def residuals(self, point: Point) -> Iterator[tuple[slice, Tensor]]:
        """Window by window which groups, and their residuals."""
        for part in self.frame.windows(self.segments):
            yield part, self.residual(point, part)

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """See :meth:`Factor.loss`."""
        weight = self.weight(noise)
        squares = ((r.square() * (weight if weight.ndim == 1 else weight[part])) for part, r in self.residuals(point))
        return float(sum(float(square.sum()) for square in squares))


class Piece(NamedTuple):
    """Residuals of some channels in some groups of times.

    Attributes:
        channels: Which of the K.
        first, groups: The first of the groups, and how many the record has.
        residual: (I, S, k), 0 at padding.
    """

    channels: slice
    first: int
    groups: int
    residual: Tensor


class Channels(Factor):
    """Sensors whose noise is to be found, each at a level of its own; K of them.

    Attributes:
        name: What their levels are called, too.
        sensors: K of them, None where there is none.
        present: (K,) bool, which of them exist.
        samples: (K,), that are compared.
        acting: (K,) bool, those that feel what acts on a structure; the others feel what it does.
    """

    sensors: Sequence[SensorSamples | None]
    present: np.ndarray
    samples: np.ndarray
    acting: np.ndarray

    def numbers(self, number: str) -> np.ndarray:
        """(K,), a number of every sensor, by its name there; NaN where there is none."""
        return np.array([np.nan if sensor is None else getattr(sensor, number) for sensor in self.sensors])

    @property
    def values(self) -> np.ndarray:
        """(K,), how many independent values their log variances count for."""
        return self.samples

    @abstractmethod
    def residuals(self, point: Point) -> Iterator[Piece]:
        """Piece by piece of the record."""

    @abstractmethod
    def moved(self, point: Point, steps: Sequence[Point]) -> Iterator[tuple[slice, list[Tensor]]]:
        """Piece by piece which channels, and how what they show changes with each of some small steps, (I, S, k)."""

    @abstractmethod
    def at(self, point: Point, noise: NoiseModel) -> Iterator[ChannelAtPoint]:
        """Every channel that exists."""

    def residuals_of_samples(self, point: Point) -> dict[str, np.ndarray]:
        """See :attr:`pinn_cli.training.estimate.Estimate.left`."""
        return {}

    def squares(self, point: Point) -> np.ndarray:
        """(K,), sums of squares of the residuals that the noise's level is told by."""
        total = np.zeros(len(self.present))
        for piece in self.residuals(point):
            total[piece.channels] += piece.residual.square().sum((0, 1)).cpu().numpy()
        return total

    def squares_moved(self, point: Point, steps: Sequence[Point]) -> np.ndarray:
        """(K,), the same of the changes of what they show with small steps, added up over these."""
        total = np.zeros(len(self.present))
        for channels, moved in self.moved(point, steps):
            total[channels] += sum(change.square().sum((0, 1)) for change in moved).cpu().numpy()  # type: ignore[union-attr]
        return total
