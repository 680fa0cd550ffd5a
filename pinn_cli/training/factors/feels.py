"""What a sensor may feel of the functions of time: each kind of sensor is a class of this page.

A kind says what it feels, and what that is made of: parts, and what parameters of the model do to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from pinn_cli.record.channel import Channel
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import CONNECTION_FORCE, GROUND, TILT
from pinn_cli.training.factors.channel_at_point import Part


class Feels(ABC):
    """What a sensor feels."""

    @abstractmethod
    def value(self, jet: Jet, parameters: Mapping[str, Tensor]) -> Tensor:
        """(I, S), of functions (I, S, N)."""

    @abstractmethod
    def linearised(self, jet: Jet, parameters: Mapping[str, Tensor]) -> tuple[list[Part], dict[int, Tensor]]:
        """The derivative of that by the functions and theirs; place of an uncertain parameter to that by it (I, S)."""


class WeightedSum(Feels):
    """A weighted sum of functions, or of derivatives of them.

    Args:
        parts: With numbers as weights.
    """

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
    """The force of a connection, whatever its law.

    Args:
        dynamics: Of the functions.
        vector: The uncertain parameters.
        connection: Which, counted from 0.
    """

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
    """What a channel feels before any filter of its own.

    Args:
        channel: Of the record.
        dynamics: Of the functions.
        vector: The uncertain parameters.
    """
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
