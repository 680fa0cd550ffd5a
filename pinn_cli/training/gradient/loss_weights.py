"""Weights of the loss terms: what all kinds share, and the fixed ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pinn_cli.network.base import Network
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import non_negative_number
from pinn_cli.training.gradient.learned_parameters import LearnedParameters
from pinn_cli.training.gradient.losses import Losses


class Weights(ABC):
    """Weights lambda of the loss terms; a kind that finds its own does so where a stage begins."""

    @abstractmethod
    def by_term(self, physics_factor: float) -> dict[str, float]:
        """Weight of every term of :meth:`Losses.terms`.

        Args:
            physics_factor: That of the stage, for the equations of motion.
        """

    @abstractmethod
    def begin_stage(self, losses: Losses, network: Network, parameters: LearnedParameters, stage: int) -> None:
        """Find the weights of the stage (counted from 0), with the network and the parameters where it begins."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """What was found."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from there."""


@dataclass(frozen=True)
class LossWeights(Weights):
    """Fixed weights lambda of the loss terms.

    Attributes:
        observation, continuity: As in the paper.
        physics: Of the equations of motion of the DOFs whose force is measured, and of the others by default.
        unforced: Of the equations of motion of the DOFs that are known to carry no force; None: as ``physics``.

    Raises:
        InputError: A weight that is negative or not finite.
    """

    observation: float = 1.0
    continuity: float = 10.0
    physics: float = 100.0
    unforced: float | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "unforced" or value is not None:
                non_negative_number(f"training.weights.{name}", value)

    @classmethod
    def read(cls, weights: Mapping[str, float | None]) -> LossWeights:
        """From a mapping; what it leaves out has the paper's value.

        Raises:
            InputError: A name that is no weight, or a value that is none.
        """
        for name, value in weights.items():
            if name not in cls.__dataclass_fields__:
                raise InputError(f"training.weights.{name}", value, f"one of {', '.join(cls.__dataclass_fields__)}")
        return cls(**weights)  # type: ignore[arg-type]

    def by_term(self, physics_factor: float) -> dict[str, float]:
        """Weight of every term of :meth:`Losses.terms`, those of the equations of motion times a factor."""
        unforced = self.physics if self.unforced is None else self.unforced
        return {
            "observation": self.observation,
            "continuity": self.continuity,
            "forced": physics_factor * self.physics,
            "unforced": physics_factor * unforced,
            "prior": 1.0,
        }

    def begin_stage(self, losses: Losses, network: Network, parameters: LearnedParameters, stage: int) -> None:
        """See :meth:`Weights.begin_stage`; there is nothing to find."""

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Weights.state_dict`."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Weights.load_state_dict`."""
