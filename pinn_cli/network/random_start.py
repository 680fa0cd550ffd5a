"""Networks that start from random weights."""

from __future__ import annotations

from abc import ABC, abstractmethod


class RandomStart(ABC):
    """What a network adds to :class:`pinn_cli.network.base.Network` if its weights cannot start from zero."""

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Draw all weights anew; the same seed gives the same weights and leaves torch's global generator alone."""
