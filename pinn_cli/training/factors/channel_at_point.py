"""What a sensor feels of the functions of time, and one channel where a record is solved.

Each kind of sensor is a class of this page. It says what it feels, and what that is made of: parts, and what parameters
of the model do to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.record.channel import Channel
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import CONNECTION_FORCE, GROUND, TILT
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


class Feels(ABC):
    """What a sensor feels."""

    @abstractmethod
    def value(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """(I, S), of functions (I, S, N)."""

    @abstractmethod
    def linearised(self, jet: Jet, parameters: Mapping[str, Tensor]) -> tuple[list[Part], dict[int, Tensor]]:
        """The derivative of that by the functions and theirs; place of an uncertain parameter to that by it (I, S)."""


class WeightedSum(Feels):
    """A sum of functions, or of derivatives of them, weighted by numbers."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self.terms = list(parts)

    def value(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """See :meth:`Feels.value`."""
        out = jet.value.new_zeros(jet.value.shape[:-1])
        for function, order, weight in self.parts(parameters):
            out = out + weight * jet[order][..., function]
        return out

    def parts(self, parameters: Mapping[str, Tensor]) -> list[Part]:
        """What it is made of, wherever the functions are."""
        return self.terms

    def linearised(self, jet: Jet, parameters: Mapping[str, Tensor]) -> tuple[list[Part], dict[int, Tensor]]:
        """See :meth:`Feels.linearised`."""
        return self.parts(parameters), {}


class Tilting(WeightedSum):
    """An accelerometer that turns with its place: it feels g over a length times the displacement as well.

    Args:
        parts: Of what it feels when it does not turn.
        turning: Of the displacement of its place.
        number: Of the channel.
        place: Of the tilt among the uncertain parameters; None: it is known.
    """

    def __init__(self, parts: Sequence[Part], turning: Sequence[Part], number: int, place: int | None) -> None:
        super().__init__(parts)
        self.turning, self.number, self.place = WeightedSum(turning), number, place

    def parts(self, parameters: Mapping[str, Tensor]) -> list[Part]:
        """See :meth:`WeightedSum.parts`."""
        tilt = parameters[TILT][self.number]
        return [*self.terms, *(Part(function, order, tilt * w) for function, order, w in self.turning.terms)]

    def linearised(self, jet: Jet, parameters: Mapping[str, Tensor]) -> tuple[list[Part], dict[int, Tensor]]:
        """See :meth:`Feels.linearised`."""
        by = {} if self.place is None else {self.place: self.turning.value(jet, parameters)}
        return self.parts(parameters), by


class ConnectionForce(Feels):
    """The force of a connection, counted from 0, whatever its law."""

    def __init__(self, dynamics: Dynamics, vector: ParameterVector[Any], connection: int) -> None:
        self.dynamics, self.vector, self.connection = dynamics, vector, connection

    def value(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """See :meth:`Feels.value`."""
        return self.dynamics.connection_force(jet, parameters)[..., self.connection]

    def linearised(self, jet: Jet, parameters: Mapping[str, Tensor]) -> tuple[list[Part], dict[int, Tensor]]:
        """See :meth:`Feels.linearised`."""
        dynamics, vector, c = self.dynamics, self.vector, self.connection
        structure, carriers = dynamics.structure, dynamics.structure.carriers
        slope = structure.linearise(dynamics.stretching(jet.value), dynamics.stretching(jet.rate), parameters)
        stretch, parts = dynamics.stretched[c], []
        for function, weight in zip(stretch.indices.tolist(), stretch.data.tolist(), strict=True):
            parts.append(Part(function, 0, weight * slope.stiffness[..., c]))
            parts.append(Part(function, 1, weight * slope.damping[..., c]))
        if structure.hidden_force[c] >= 0:
            parts.append(Part(dynamics.hidden.start + int(structure.hidden_force[c]), 0, 1.0))
        by = {
            vector.first[p.kind] + p.index: slope.by_parameter[p.kind][..., mask].sum(-1)
            for p in vector.moving
            if p.kind in slope.by_parameter
            and (mask := (dynamics.branch(p.kind) == c) & (carriers[p.kind][1] == p.index)).any()
        }
        return parts, by


def felt_by(channel: Channel, dynamics: Dynamics, vector: ParameterVector[Any]) -> Feels:
    """What a channel feels before any filter of its own; ``vector`` has the uncertain parameters."""
    if channel.quantity == CONNECTION_FORCE:
        return ConnectionForce(dynamics, vector, channel.connection)
    parts = weighted(dynamics, channel.quantity, channel.weights)
    if TILT not in channel.calibration:
        return WeightedSum(parts)
    turning, first = weighted(dynamics, "displacement", channel.weights), vector.first
    moves = any(p.kind == TILT and p.index == channel.index for p in vector.moving)
    return Tilting(parts, turning, channel.index, first[TILT] + channel.index if moves else None)


def weighted(dynamics: Dynamics, quantity: str, dof_weights: Mapping[int, float]) -> list[Part]:
    """Of a sensor of a quantity that feels a weighted sum of DOFs, counted from 0; the ground is felt as it is."""
    weights: defaultdict[tuple[int, int], float] = defaultdict(float)
    channels = {0: 1.0} if quantity == GROUND else dof_weights
    for order, matrix in dynamics.sensing(quantity):
        for channel, weight in channels.items():
            row = matrix[channel]
            for function, share in zip(row.indices.tolist(), row.data.tolist(), strict=True):
                weights[function, order] += weight * share
    return [Part(function, order, weight) for (function, order), weight in weights.items() if weight]


@dataclass(frozen=True, eq=False)
class ChannelAtPoint:
    """One channel at a point.

    Attributes:
        name: For people.
        quantity: That it measures.
        segments: Of its samples.
        features: (I, S, B), and derivatives of them.
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
    features: Sequence[Tensor]
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
