"""What acts on a structure: measured forces, the ground, and supports that move, at any time, and their errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from pinn_cli.record.between_samples import dense_spline
from pinn_cli.record.record import Record
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import MOTION, SUPPORT
from pinn_cli.system.structure import Structure


def input_force(structure: Structure, record: Record) -> np.ndarray:
    """(N, n), N: measured forces, and the ground's acceleration times the masses that it moves, S f - M iota a_g.

    Of supports their displacement times the springs that it stretches, or their acceleration times what it moves.
    """
    acting = structure.shapes.onto_coordinates(np.nan_to_num(record.force))
    mass = structure.parameters_like(np.empty(0))[MASS]
    if record.ground_acceleration is not None:
        acting = acting - np.outer(np.nan_to_num(record.ground_acceleration), mass * structure.with_ground)
    if structure.by_supports is None:
        return acting
    springs = (
        structure.at_rest()[0].sum(axis=0)[:, None] * structure.stretch.matrix[:, structure.coordinates :].toarray()
    )
    stiffness = abs(structure.incidence.matrix.T @ springs)
    for i, (quantity, order) in enumerate(measured_orders(record)):
        of_spring = stiffness[:, i] ** (1.0 - 0.5 * order)
        moved = of_spring * np.where(stiffness[:, i] > 0.0, mass, 0.0) ** (0.5 * order)
        acting = acting + np.outer(record.supports[quantity][:, i], moved)
    return acting


def measured_orders(record: Record) -> list[tuple[str, int]]:
    """Of every support the quantity that tells most of its slow motion, and its order: 0, 1, 2 derivatives."""
    return [
        min(((q, MOTION.index(SUPPORT[q])) for q in record.supports if record.sensors(q)[i]), key=lambda pair: pair[1])
        for i in range(len(record.support_names))
    ]


def support_motion(record: Record, first: int = 0) -> Callable[[np.ndarray], np.ndarray] | None:
    """From times (M,) from a sample on to the motion (M, 3, S) of the supports, by splines; None where none moves.

    A velocity or an acceleration is integrated from :attr:`Record.supports_begin`, and so is the sensor's noise.
    """
    if not record.supports:
        return None
    time = record.time[first:]
    begins = np.zeros((2, len(record.support_names))) if record.supports_begin is None else record.supports_begin
    jets = []
    for i, (quantity, order) in enumerate(measured_orders(record)):
        spline = dense_spline(time, record.supports[quantity][first:, i])
        # What is integrated begins as it is known to: a polynomial more.
        start = Polynomial([begins[k, i] / math.factorial(k) for k in range(order)] or [0.0])
        jets.append((spline.antiderivative(order), order, start))

    def motion(at: np.ndarray) -> np.ndarray:
        out = np.empty((len(at), 3, len(jets)))
        for i, (history, order, start) in enumerate(jets):
            for k in range(3):
                out[:, k, i] = history(at, k) + (start.deriv(k)(at - time[0]) if order > k else 0.0)
        return out

    return motion


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
        """Of a record, by the noise of every support's sensor, (S,) of each quantity; None where no support moves."""
        if not record.supports:
            return None
        orders = measured_orders(record)
        sigma = [levels[quantity][i] if quantity in levels else 0.0 for i, (quantity, _) in enumerate(orders)]
        return cls(np.nan_to_num(sigma), np.array([order for _, order in orders]), record.step)

    def drawn(self, random: np.random.Generator, samples: int, before: np.ndarray) -> np.ndarray:
        """(M, H, 3, S), errors of displacement, velocity and acceleration at M - 1 samples, behind those before."""
        noise = self.sigma * random.standard_normal((samples, len(before), len(self.sigma)))
        out = np.zeros((samples + 1, *before.shape))
        out[0] = before
        for i, order in enumerate(self.order):
            out[1:, :, order, i] = noise[..., i]
            for k in range(order - 1, -1, -1):
                rate = out[:, :, k + 1, i]
                out[1:, :, k, i] = before[:, k, i] + np.cumsum(0.5 * self.step * (rate[1:] + rate[:-1]), axis=0)
        return out
