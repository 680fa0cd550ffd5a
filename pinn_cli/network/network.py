"""What a network N(t; theta) is: time in, the motion of every DOF and its time derivatives out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal, NamedTuple, get_args

import torch
from torch import Tensor, nn

from pinn_cli.record.record import Record

Continuity = Literal["exact", "penalised"]
CONTINUITIES: tuple[str, ...] = get_args(Continuity)


class States(NamedTuple):
    """Motion at N times, each (N, ndof).

    Attributes:
        displacement, velocity, acceleration: m, m/s, m/s^2.
        continuity: d(displacement)/dt - velocity, m/s, where the network has separate outputs for the two; None where
            it vanishes by construction.
    """

    displacement: Tensor
    velocity: Tensor
    acceleration: Tensor
    continuity: Tensor | None


class Network(nn.Module, ABC):
    """A network from time to the motion of ``ndof`` degrees of freedom.

    With ``continuity="exact"`` its outputs are displacements and everything else are their derivatives. With
    ``"penalised"`` it has separate outputs for displacement and velocity, (N, 2 ndof), as in the paper, and a residual
    says how far they disagree (paper, eq. 10b).
    """

    def __init__(self, ndof: int, continuity: Continuity) -> None:
        super().__init__()
        self.ndof = ndof
        self.continuity: Continuity = continuity

    @property
    def channels(self) -> int:
        """Outputs per DOF."""
        return 1 if self.continuity == "exact" else 2

    def reset(self, seed: int) -> None:
        """Draw all weights anew, where they cannot start from zero; otherwise there is nothing to draw.

        The same seed gives the same weights and leaves torch's global generator alone.
        """

    @abstractmethod
    def jet(self, time: Tensor, order: int) -> tuple[Tensor, ...]:
        """Outputs and their derivatives by time (N,), s, up to ``order`` (0, 1 or 2), each (N, channels * ndof)."""

    def forward(self, time: Tensor) -> States:
        """Motion at the given times (N,), s."""
        return self.states(self.jet(time, self.order))

    @property
    def order(self) -> int:
        """Of the derivatives of its outputs that make a motion."""
        return 2 if self.continuity == "exact" else 1

    def states(self, jet: tuple[Tensor, ...]) -> States:
        """The motion, from its outputs and their derivatives up to this order."""
        if self.continuity == "exact":
            displacement, velocity, acceleration = jet
            return States(displacement, velocity, acceleration, None)
        (value, rate), n = jet, self.ndof
        return States(value[:, :n], value[:, n:], rate[:, n:], rate[:, :n] - value[:, n:])


class NetworkDesign(ABC):
    """What a config chooses: how to build a network for a record. A new one is a file here and in ``conf/network``."""

    name: str

    @abstractmethod
    def build(self, record: Record, dtype: torch.dtype = torch.float64, functions: int | None = None) -> Network:
        """A network fitted to the record's span, band and amplitudes (never to its truth), untrained.

        Args:
            record: What was measured.
            dtype: Of its weights.
            functions: Unknown functions of time, its outputs; None: the motion of every DOF.
        """

    def refined(self) -> NetworkDesign:
        """The same for a problem with unknown parameters, which a network too coarse for the motion would bias."""
        return self

    def within_band(self) -> NetworkDesign:
        """The design where forces are unknown: features that reach little beyond the frequencies of the record."""
        return self

    def finer(self, factor: float, record: Record) -> NetworkDesign | None:
        """A design with so many times as many features as :meth:`build` makes of a record.

        None where the user has said how many, or none are counted.
        """
        return None
