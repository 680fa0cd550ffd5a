"""Records of small chains whose roof is driven, and copies with one channel changed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.system.structure import Structure

DURATION, SAMPLES = 240.0, 1601


def measure(
    structure: Structure, snr_db: float | None = 30.0, strength: float = 1.0, quantity: str = "acceleration"
) -> Record:
    """The chain's record from rest, its roof driven; sensors of one kind everywhere."""
    return measurements(structure, snr_db, strength).record.keep({quantity: range(1, structure.ndof + 1)})


def measurements(structure: Structure, snr_db: float | None = 30.0, strength: float = 1.0) -> Measurements:
    force = BandedNoise(structure.ndof, DURATION, SAMPLES, [0.03, 0.5], strength, [structure.ndof])
    return Simulated(force, Simulation(DURATION, SAMPLES), Noise(snr_db, 0)).measure(structure)


def altered(record: Record, dof: int, change: Callable[[np.ndarray], np.ndarray], of: str = "acceleration") -> Record:
    """The record with one channel changed; the DOF counted from 1."""
    values = getattr(record, of).copy()
    values[:, dof - 1] = change(values[:, dof - 1])
    return replace(record, **{of: values})


def exchanged(record: Record, first: int, second: int) -> Record:
    """The record with the accelerations of two DOFs, counted from 1, in each other's place."""
    order = np.arange(record.ndof)
    order[[first - 1, second - 1]] = second - 1, first - 1
    return replace(record, acceleration=record.acceleration[:, order])
