"""Energy that connections dissipate: against closed forms, balances of simulated motions, and in the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_estimates import make_estimate
from structures import braced, hysteretic

from pinn_cli.record.response import Response
from pinn_cli.record.simulation import simulate
from pinn_cli.report.energy import COLUMNS, DissipatedEnergy, dissipated, energy_table
from pinn_cli.report.results import LABELS
from pinn_cli.system import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.training.estimate import ConnectionHistories

RUN = dict.fromkeys(LABELS, "x")


def test_a_damper_under_a_sine():
    structure = build_chain(2, Duffing(), m=1.0, c=[2.0, 3.0], k=15.0, kappa=100.0)
    time = np.linspace(0.0, 5.0, 2001)
    u = np.outer(np.sin(2.0 * np.pi * time), [0.1, 0.3])
    v = 2.0 * np.pi * np.outer(np.cos(2.0 * np.pi * time), [0.1, 0.3])
    found = dissipated(structure, Response(time, u, v, 0 * u, 0 * u))
    # pi c omega X^2 a cycle, five of them; springs give back what they take.
    np.testing.assert_allclose(found, 5 * np.pi * np.array([2.0, 3.0]) * 2.0 * np.pi * np.array([0.1, 0.2]) ** 2)


@pytest.mark.parametrize("structure", [braced(), hysteretic()], ids=["braced", "hysteretic"])
def test_work_of_the_force_is_dissipated_where_the_motion_has_died_away(structure):
    n, time = structure.ndof, np.linspace(0.0, 120.0, 2401)

    def force(t: np.ndarray) -> np.ndarray:
        return np.outer(np.exp(-(((t - 10.0) / 3.0) ** 2)) * np.sin(1.5 * t), np.arange(n) == n - 1) * 2.0

    response = simulate(structure, force, time, substeps=1)
    work = np.trapezoid(np.sum(force(time) * response.velocity, axis=1), time)
    assert work > 0.1
    # A hidden force that is left over holds a spring bent: that much is stored.
    e = structure.elongation(response.displacement[-1])
    p = structure.parameters_like(e)
    left = 0.5 * np.sum(p["k"] * e**2)
    stored = 0.0 if response.hidden is None else 0.5 * np.sum(response.hidden[-1] ** 2 / p["A"])
    np.testing.assert_allclose(dissipated(structure, response).sum() + left + stored, work, rtol=2e-3)


def test_the_table(make_case):
    structure = build_chain(3, Duffing(), m=1.0, c=1.0, k=15.0, kappa=100.0)
    case = make_case(ndof=3)
    motion = case.estimate.response
    blank = np.zeros((len(motion.time), 3))
    known = ConnectionHistories(*[blank] * 4, np.array([1.0, 2.0, 1.0]), np.array([0.1, 0.1, 0.2]))
    energy = DissipatedEnergy.of(structure, replace(case.estimate, connections=known, parameters=[]), motion, structure)
    table = energy_table(energy, RUN)
    assert list(table) == [*LABELS, *COLUMNS]
    np.testing.assert_allclose(table["share_percent"], [25.0, 50.0, 25.0])
    np.testing.assert_allclose(table["upper_90"] - table["dissipated"], 1.6448536 * np.array([0.1, 0.1, 0.2]))
    np.testing.assert_allclose(table["true"], dissipated(structure, motion))


def test_without_deviations_and_without_a_truth():
    structure = build_chain(3, Duffing(), m=1.0, c=1.0, k=15.0, kappa=100.0)
    case = make_estimate(ndof=3)
    estimate = replace(case.estimate, parameters=[])
    table = energy_table(DissipatedEnergy.of(structure, estimate, case.truth.response), RUN)
    np.testing.assert_allclose(table["dissipated"], dissipated(structure, estimate.response))
    assert table[["std", "lower_90", "true", "error_percent"]].isna().all(axis=None)
