"""A measured response channel, as the verdict names it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.record import RESPONSE_QUANTITIES

if TYPE_CHECKING:
    from pinn_cli.record.record import Record, Response


@dataclass(frozen=True, eq=False)
class Channel:
    """One response sensor and what it measured.

    Attributes:
        quantity: displacement, velocity or acceleration.
        dof: Counted from 0.
        measured: (N,), in the quantity's unit.
    """

    quantity: str
    dof: int
    measured: np.ndarray

    @property
    def name(self) -> str:
        """As sentences have it, the DOF counted from 1: ``acceleration of DOF 3``."""
        return f"{self.quantity} of DOF {self.dof + 1}"

    @property
    def setting(self) -> str:
        """Where a user gave it: ``data.acceleration, DOF 3``."""
        return f"data.{self.quantity}, DOF {self.dof + 1}"

    @property
    def order(self) -> int:
        """How often the displacement is differentiated."""
        return RESPONSE_QUANTITIES.index(self.quantity)

    def of(self, response: Response) -> np.ndarray:
        """The same quantity of the same DOF in a response, (N,)."""
        values: np.ndarray = getattr(response, self.quantity)[:, self.dof]
        return values


def channels(record: Record) -> list[Channel]:
    """Every response sensor of a record."""
    return [
        Channel(quantity, int(dof), getattr(record, quantity)[:, dof])
        for quantity in RESPONSE_QUANTITIES
        for dof in np.flatnonzero(record.sensors(quantity))
    ]
