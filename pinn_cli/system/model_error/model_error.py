"""What a model error is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from pinn_cli.system.structure import Structure


class ModelError(ABC):
    """The difference between the structure that makes the data and the model that the estimator is given.

    A new one is a file here and a file in ``conf/model_error``; nothing else changes.

    Attributes:
        name: What the tables call it.
    """

    name: ClassVar[str]

    @abstractmethod
    def structures(self, nominal: Structure) -> tuple[Structure, Structure]:
        """The true chain, which is simulated, and the prescribed one, which the estimator is given."""
