"""The noise that a training found: of every sensor, and of what the model leaves out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pinn_cli.record.channel import CALIBRATED, Channel
from pinn_cli.record.response import MEASURED_QUANTITIES

# How levels are called in ``run.json``, before the name of what they are of.
SIGMA, DISCREPANCY, TAKEN = "sigma_", "sigma_discrepancy", "effective_parameters"


@dataclass(frozen=True, eq=False)
class FoundNoise:
    """Standard deviations.

    Attributes:
        sensors: Quantity (`CALIBRATED` of calibrated channels) to those of its sensors (C,), in the unit of what they
            feel; NaN where there is none. Empty where the training finds none.
        discrepancy: N, per sample, of the force that the model leaves out; NaN where the training has none.
        taken: Likewise of how many values of each sensor's samples the solution has taken up.
    """

    sensors: Mapping[str, np.ndarray] = field(default_factory=dict)
    discrepancy: float = math.nan
    taken: Mapping[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def read(cls, summary: Mapping[str, Any]) -> FoundNoise:
        """From what :attr:`summary` has left in ``run.json``."""
        pairs = ((name, summary.get(f"{SIGMA}{name}")) for name in (*MEASURED_QUANTITIES, CALIBRATED))
        sensors = {quantity: _numbers(values) for quantity, values in pairs if values is not None}
        taken = {quantity: _numbers(values) for quantity, values in summary.get(TAKEN, {}).items()}
        discrepancy = summary.get(DISCREPANCY)
        return cls(sensors, math.nan if discrepancy is None else discrepancy, taken)

    @property
    def summary(self) -> dict[str, Any]:
        """For ``run.json``."""
        taken = {TAKEN: {quantity: _listed(values) for quantity, values in self.taken.items()}} if self.taken else {}
        discrepancy = {} if math.isnan(self.discrepancy) else {DISCREPANCY: float(self.discrepancy)}
        return (
            taken | discrepancy | {f"{SIGMA}{quantity}": _listed(values) for quantity, values in self.sensors.items()}
        )

    def of(self, channel: Channel) -> float:
        """That of one sensor; NaN where the training found none."""
        quantity, place = channel.place
        levels = self.sensors.get(quantity, np.empty(0))
        return float(levels[place]) if place < len(levels) else math.nan


def _numbers(values: list[float | None]) -> np.ndarray:
    return np.array([math.nan if x is None else x for x in values], dtype=float)


def _listed(values: np.ndarray) -> list[float | None]:
    return [None if np.isnan(x) else float(x) for x in values]
