"""The paper's own signals, array by array, through system, model error, excitation, simulation and noise."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.response import QUANTITIES
from pinn_cli.record.simulated import add_noise
from pinn_cli.record.simulation import Simulation
from pinn_cli.system import build_chain
from pinn_cli.system.connection import Duffing, VanDerPol
from pinn_cli.system.model_error import NoModelError, PerturbedModelError

NO_ERROR = NoModelError()
CASES = {
    "sr_6dof": (6, 60.0, Duffing(), NO_ERROR),
    "sr_20dof": (20, 60.0, Duffing(), NO_ERROR),
    "sr_6dof_perturbed": (6, 60.0, Duffing(), PerturbedModelError(seed=43810, draws="authors")),
    "sp_5dof": (5, 60.0, Duffing(), NO_ERROR),
    "sp_5dof_van_der_pol": (5, 60.0, VanDerPol(), NO_ERROR),
    "sp_5dof_perturbed": (5, 60.0, Duffing(), PerturbedModelError(seed=43810, draws="authors", seed_stride=100)),
    "pe_2dof": (2, 240.0, Duffing(), NO_ERROR),
    "pe_2dof_van_der_pol": (2, 240.0, VanDerPol(), NO_ERROR),
}
AUTHORS_SEEDS = {"displacement": 43810, "velocity": 13927, "acceleration": 2024, "force": 1234}
COEFFICIENT = {"duffing": {"kappa": 100.0}, "van_der_pol": {"mu": 0.75}}


def largest_relative_error(x: np.ndarray, reference: np.ndarray) -> float:
    return float(np.max(np.abs(x - reference)) / np.max(np.abs(reference)))


@pytest.mark.parametrize("case", CASES)
def test_every_array_is_reproduced(shared, case):
    ndof, duration, nonlinearity, model_error = CASES[case]
    nominal = build_chain(ndof, nonlinearity, m=10.0, c=1.0, k=15.0, **COEFFICIENT[nonlinearity.name])
    structure, _ = model_error.structures(nominal)
    simulation = Simulation(duration, 4096, hold="zero_order")
    excitation = BandedNoise(ndof, duration, 4096, band=[0.05, 1.0], rms=None, dofs=[1], seed=43810, phases="authors")
    response = simulation.run(structure, excitation.force)

    reference = dict(np.load(shared / "data" / "reference_signals" / f"{case}.npz"))
    ours = {"time": response.time, **{quantity: getattr(response, quantity) for quantity in QUANTITIES}}
    ours |= {name: value.numpy() for name, value in structure.parameters.items()}
    for snr_db in (50, 20, 10):
        noisy = add_noise(response, snr_db, seeds=AUTHORS_SEEDS)
        ours |= {f"{quantity}_snr{snr_db}": getattr(noisy, quantity) for quantity in QUANTITIES}
    for name, array in reference.items():
        if name in ("kappa", "mu") and name not in ours:
            assert not array.any()
        else:
            assert largest_relative_error(ours[name], array) < 1e-9, name


def test_the_authors_force_has_the_rms_that_the_readme_states(shared):
    force = np.load(shared / "data" / "reference_signals" / "sr_6dof.npz")["force"][:, 0]
    assert np.sqrt(np.mean(force**2)) == pytest.approx(1.3034, abs=5e-5)
