"""A motion to start from, for strongly nonlinear chains whose search from rest ends in the wrong valley."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import evidence_of, levels_of, shown_noise
from small_problems import QUANTITIES, measured, small_chain
from solved_records import by_spline

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.free_run import NoFreeRunError, free_run
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.evidence import Evidence
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.steps import first_solution
from pinn_cli.training.steps.discrepancy_search import scanned, searched
from pinn_cli.training.steps.first_solution import simulated_start


def equations(record: Record, structure: Structure, uncertain=(), design=None) -> NormalEquations:
    return NormalEquations((design or Spline()).build(record), Problem(structure, record, uncertain))


@pytest.mark.parametrize("design", [Spline(), Fourier()], ids=["spline", "fourier"])
@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_it_is_the_motion_of_the_prescribed_chain_from_rest(hold, design):
    measurements = measured(small_chain(), hold)
    found = equations(measurements.record.keep({"acceleration": (1,)}), small_chain(), design=design)
    point = simulated_start(found)
    motion = found.flat_states(found.observation, point)
    for quantity in ("displacement", "velocity"):
        truth = getattr(measurements.truth.response, quantity)
        # A network follows the motion as well as its features do: a few thousandths.
        np.testing.assert_allclose(getattr(motion, quantity), truth, atol=0.01 * np.abs(truth).max())


def test_there_is_none_where_the_motion_cannot_be_simulated():
    """A force or a parameter is unknown, velocities are outputs of their own, springs push, or are too stiff."""
    structure, record = small_chain(), measured(small_chain()).record
    force = record.force.copy()
    force[:, 1] = np.nan
    pushing = small_chain("linear")
    pushing = pushing.with_parameters(k=-5e3 * pushing.parameters["k"])
    driven = measured(small_chain("linear")).record
    with pytest.raises(NoFreeRunError, match="unstable"):
        free_run(pushing, driven)
    for none in (
        equations(replace(record, force=force, unforced=np.array([False, False, True])), structure),
        equations(record, structure, (Parameter("k", 1, 3.0, 100.0, unknown=True),)),
        equations(record, structure, design=Spline(continuity="penalised")),
        equations(driven, pushing),
        equations(record, small_chain(k=1e9)),
    ):
        assert simulated_start(none) is None


def searching(record: Record) -> tuple[Evidence, NoiseLevels]:
    found = equations(record, small_chain())
    noise = shown_noise(record, 1.0, 1.0)
    return evidence_of(found), levels_of(noise)


def test_a_search_that_finds_a_good_model_asks_for_no_second_start():
    evidence, noise = searching(measured(small_chain(), snr_db=40.0).record)

    def never() -> None:
        raise AssertionError("a second start was asked for")

    searched(evidence, noise, 1.0, never)


def test_without_a_second_start_the_first_one_stands(monkeypatch):
    evidence, noise = searching(measured(small_chain(), snr_db=40.0).record)
    monkeypatch.setattr("pinn_cli.training.steps.discrepancy_search.SUSPICIOUS_DISCREPANCY", 0.0)
    asked = []
    first = searched(evidence, noise, 1.0, lambda: asked.append(None))
    assert len(asked) == 1
    assert first.log_evidence == scanned(evidence, noise, 1.0, evidence.equations.start()).log_evidence


@pytest.mark.slow
def test_of_two_the_more_probable_one_is_taken(monkeypatch):
    """A second start of nonsense does no harm."""
    record = measured(small_chain(), snr_db=40.0).record
    evidence, noise = searching(record)
    expected = scanned(evidence, noise, 1.0, evidence.equations.start())
    monkeypatch.setattr("pinn_cli.training.steps.discrepancy_search.SUSPICIOUS_DISCREPANCY", 1e-9)
    rest = evidence.equations.start()
    wild = replace(rest, unknowns=torch.linspace(-50.0, 50.0, len(rest.unknowns), dtype=torch.float64))
    found = searched(evidence, noise, 1.0, lambda: wild)
    assert found.log_evidence >= expected.log_evidence


STRONG = build_chain(6, Duffing(), m=10.0, c=1.0, k=15.0, kappa=5000.0)


def strongly_nonlinear() -> Measurements:
    """Springs whose cubic part carries most: one accelerometer on six DOFs."""
    force = BandedNoise(6, 20.0, 513, [0.05, 1.0], 5.0, [1])
    return Simulated(force, Simulation(20.0, 513), Noise(50.0)).measure(STRONG)


def recovered(measurements: Measurements) -> Estimate:
    scheme = SparseRecovery(unobserved=[2, 3, 4, 5, 6])
    problem = scheme.pose(STRONG, [scheme.observe(measurements.record)])
    return by_spline(problem)


def worst_fitness(estimate: Estimate, measurements: Measurements) -> float:
    truth = measurements.truth.response
    return min(fitness_percent(getattr(estimate.response, q), getattr(truth, q)).min() for q in QUANTITIES)


@pytest.mark.slow
def test_a_strongly_nonlinear_chain_needs_it(monkeypatch):
    measurements = strongly_nonlinear()
    found = recovered(measurements)
    assert worst_fitness(found, measurements) > 97.0
    monkeypatch.setattr(first_solution, "simulated_start", lambda equations: None)
    alone = recovered(measurements)
    assert worst_fitness(alone, measurements) < 50.0
    assert alone.summary["log_evidence"] < found.summary["log_evidence"] - 100.0
