"""Small simulated chains, records and problems, for tests about networks, physics and training."""

from dataclasses import replace

import numpy as np

from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, PowerDamping, VanDerPol
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure

NONLINEARITIES = {
    "linear": (Linear(), {}),
    "duffing": (Duffing(), {"kappa": 100.0}),
    "van_der_pol": (VanDerPol(), {"mu": 0.75}),
    "power_damping": (PowerDamping(1.5), {"mu": 0.75}),
}
QUANTITIES = ("displacement", "velocity", "acceleration")


def small_chain(nonlinearity: str = "duffing", ndof: int = 3, speed: float = 1.0, k: float = 15.0) -> Structure:
    """A chain whose motion is ``speed`` times as fast as that of the paper's."""
    kind, parameters = NONLINEARITIES[nonlinearity]
    return build_chain(ndof, kind, m=10.0 / speed**2, c=1.0 / speed, k=k, **parameters)


def excitation(structure: Structure, duration: float = 12.0, samples: int = 257) -> BandedNoise:
    return BandedNoise(structure.ndof, duration, samples, [2.5 / duration, 15.0 / duration], 1.0, [1])


def measured(
    structure: Structure,
    hold: str = "exact",
    snr_db: float | None = None,
    duration: float = 12.0,
    samples: int = 257,
    seed: int = 0,
) -> Measurements:
    """A record of the first DOF's force and of every response, with the truth."""
    simulation = Simulation(duration, samples, hold)
    return Simulated(excitation(structure, duration, samples), simulation, Noise(snr_db, seed)).measure(structure)


def accelerations(record: Record, dofs: tuple[int, ...] = (1, 2)) -> Record:
    """The record with accelerometers on the given DOFs only."""
    return record.keep({"acceleration": dofs})


def believed(structure: Structure, *places: tuple[str, int], share: float = 0.1) -> tuple[Parameter, ...]:
    """Parameters by kind and number, known to a share of what they are."""
    values = [float(structure.parameters[kind][number]) for kind, number in places]
    return tuple(Parameter(*place, value, share * value) for place, value in zip(places, values, strict=True))


def sped_up(record: Record, speed: float) -> Record:
    """The same displacements and forces, ``speed`` times as fast."""
    motion = {name: getattr(record, name) * speed**order for order, name in enumerate(QUANTITIES)}
    return replace(record, time=record.time / speed, **motion)


def relative_error(estimate: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))
