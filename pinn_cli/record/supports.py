"""What was measured of supports that move, and its errors, integrated where it is a velocity or an acceleration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.system.quantities import MOTION, SUPPORT


def told_by(record: Record) -> list[tuple[str, int]]:
    """Of every support the quantity that tells most of its slow motion, and its order: 0, 1, 2 derivatives."""
    return [
        min(((q, MOTION.index(SUPPORT[q])) for q in record.supports if record.sensors(q)[i]), key=lambda one: one[1])
        for i in range(len(record.support_names))
    ]


@dataclass(frozen=True, eq=False)
class SupportErrors:
    """White noise of the sensor that tells each support's motion; between samples it goes in straight lines.

    Attributes:
        sigma: (S,), in the sensor's unit.
        order: (S,), 0 of a displacement, 1 of a velocity, 2 of an acceleration.
        step: From sample to sample, s.
    """

    sigma: np.ndarray
    order: np.ndarray
    step: float

    @classmethod
    def of(cls, record: Record, levels: Mapping[str, np.ndarray]) -> SupportErrors | None:
        """Of a record; None where no support moves.

        Args:
            record: With their motion.
            levels: Quantity to the noise of every support's sensor, (S,).
        """
        if not record.supports:
            return None
        told = told_by(record)
        sigma = [levels[quantity][i] if quantity in levels else 0.0 for i, (quantity, _) in enumerate(told)]
        return cls(np.nan_to_num(sigma), np.array([order for _, order in told]), record.step)

    def drawn(self, random: np.random.Generator, samples: int, before: np.ndarray) -> np.ndarray:
        """(M, H, 3, S), errors of displacement, velocity and acceleration at the next samples, behind those before.

        Args:
            random: Where they come from.
            samples: M - 1.
            before: (H, 3, S), at the sample before.
        """
        noise = self.sigma * random.standard_normal((samples, len(before), len(self.sigma)))
        out = np.zeros((samples + 1, *before.shape))
        out[0] = before
        for i, order in enumerate(self.order):
            out[1:, :, order, i] = noise[..., i]
            for k in range(order - 1, -1, -1):
                rate = out[:, :, k + 1, i]
                out[1:, :, k, i] = before[:, k, i] + np.cumsum(0.5 * self.step * (rate[1:] + rate[:-1]), axis=0)
        return out
