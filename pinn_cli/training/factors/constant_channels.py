"""Channels whose rows never change: sensors on the record's clock whose calibration is known.

Rows that never change: of what feels functions of time, or derivatives of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.network.network import States
from pinn_cli.system.functions import Jet
from pinn_cli.training.factors.channel_at_point import ChannelAtPoint, weighted
from pinn_cli.training.factors.factor import Channels, Piece
from pinn_cli.training.factors.frame import EVERY, Frame
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.normal_matrix.separable_rows import FeatureWindows, LocalFeatures, SeparableRows
from pinn_cli.training.sensor_samples import SensorSamples


class ConstantRows:
    """Rows of several channels that feel functions alike.

    Args:
        segments: Features at their times.
        terms: What they feel: features (I, S, B), such as a derivative, and weights (channels, functions) of the
            functions that have them.
    """

    def __init__(self, segments: Segments, terms: Sequence[tuple[Tensor, csr_matrix]]) -> None:
        self.weights = np.stack([weights.toarray() for _, weights in terms])

        def features(part: slice) -> LocalFeatures:
            return LocalFeatures(segments.feature[part], torch.stack([phi[part] for phi, _ in terms], 2))

        self._features = FeatureWindows(features)

    def add_to(self, sums: RowSums, residual: Tensor, weight: Tensor, part: slice = EVERY) -> None:
        """Add their products in some groups.

        Residuals are (I, S, channels), and their weights (channels,), 0 where there is none.
        """
        by = residual[..., None].cpu().numpy()
        touching, places = np.any(self.weights, axis=0), np.full((by.shape[2], 1), sums.places)
        features, weights = self._features(part), weight.cpu().numpy()
        sums.add_separable(SeparableRows(features, self.weights, touching, weights, by, places, sums.places))


class ConstantChannels(Channels):
    """The channels of one quantity, K of them, those without a sensor included: ``mask`` (K,) bool has none of these.

    Attributes:
        segments: Features where they are compared.
        target: (I, S, K), what they are compared with there.
        rows: By the readout weights.
        per_sample: Points for each of their samples.
    """

    segments: Segments
    target: Tensor
    rows: ConstantRows
    per_sample = 1

    def __init__(self, frame: Frame, quantity: str, mask: Tensor) -> None:
        super().__init__(frame)
        self.name, self.mask, self.present = quantity, mask, mask.cpu().numpy()
        record = frame.problem.record
        self.samples = np.full(len(self.present), len(record.time))
        self.sensors = [
            SensorSamples(record.column(quantity, i), record) if present else None
            for i, present in enumerate(self.present)
        ]
        self._kept: tuple[Point | None, Tensor] = None, mask

    def measurands(self, states: States) -> Tensor:
        """(..., K), what they feel of a motion."""
        return self.frame.dynamics.sensed(self.name, Jet(*states[:3]))

    def weight(self, noise: NoiseModel) -> Tensor:
        """(K,), one over the variances of points that count for their share of a sample."""
        return torch.as_tensor(noise.sensor_weight(self.name) / self.per_sample).to(self.target) * self.mask

    def residual(self, point: Point, part: slice = EVERY) -> Tensor:
        """(I, S, K), of some groups."""
        return (self.measurands(self.frame.states(self.segments, point, part)) - self.target[part]) * self.mask

    def residuals(self, point: Point) -> Iterator[Piece]:
        """See :meth:`Channels.residuals`."""
        for part in self.frame.windows(self.segments):
            yield Piece(slice(0, len(self.present)), part.start, len(self.target), self.residual(point, part))

    def moved(self, point: Point, steps: Sequence[Point]) -> Iterator[tuple[slice, list[Tensor]]]:
        """See :meth:`Channels.moved`."""
        for part in self.frame.windows(self.segments):
            of_steps = (self.frame.states(self.segments, step, part) for step in steps)
            yield slice(0, len(self.present)), [self.measurands(states) * self.mask for states in of_steps]

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """See :meth:`Factor.loss`."""
        if point is not self._kept[0]:
            squares = [piece.residual.square().sum((0, 1)) for piece in self.residuals(point)]
            self._kept = point, torch.stack(squares).sum(0)
        return float(self.weight(noise) @ self._kept[1])

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        weight = self.weight(noise)
        for part in self.frame.windows(self.segments):
            self.rows.add_to(sums, self.residual(point, part), weight, part)


class ResponseChannels(ConstantChannels):
    """Sensors of a motion of the DOFs, one channel a DOF; arguments as of :class:`ConstantChannels`."""

    def __init__(self, frame: Frame, quantity: str, mask: Tensor) -> None:
        super().__init__(frame, quantity, mask)
        self.acting = np.zeros(len(self.present), bool)
        self.segments = frame.observation
        self.target = self.segments.gather(frame.target.response[quantity])
        jet = self.segments.orders
        sensing = [(jet[order], matrix) for order, matrix in frame.dynamics.sensing(quantity)]
        self.rows = ConstantRows(self.segments, sensing)

    def at(self, point: Point, noise: NoiseModel) -> Iterator[ChannelAtPoint]:
        """See :meth:`Channels.at`."""
        frame, segments = self.frame, self.segments
        states = frame.flat_states(segments, point)
        displacement = frame.dynamics.sensed("displacement", Jet(*states[:3])).cpu().numpy()
        measurands = self.measurands(states).cpu().numpy()
        residual = measurands - frame.target.response[self.name].cpu().numpy()
        for dof in np.flatnonzero(self.present).tolist():
            yield ChannelAtPoint(
                frame.problem.record.column(self.name, dof).name,
                self.name,
                segments,
                segments.orders,
                weighted(frame.dynamics, self.name, {dof: 1.0}),
                measurands[:, dof],
                displacement[:, dof],
                residual[:, dof],
                frame.problem.record.time,
                float(noise.response[self.name][dof]),
            )
