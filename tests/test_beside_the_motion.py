"""Hidden forces, the ground and forces that nobody measured, found together with the motion."""

from dataclasses import replace

import numpy as np
import pytest
from small_estimates import Case, results_of
from small_problems import excitation, measured, small_chain
from solved_records import by_spline as solved
from structures import hysteretic

from pinn_cli.network.mlp import Mlp
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation, simulate
from pinn_cli.report.estimates import connection_forces, dissipated_energy, drifts
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.settings.errors import InputError
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.gauss_newton import GaussNewton


def inside(estimate: np.ndarray, std: np.ndarray, truth: np.ndarray) -> float:
    """Share of the truth within 1.96 standard deviations."""
    return float(np.mean(np.abs(estimate - truth) < 1.96 * std))


@pytest.mark.slow
def test_a_hidden_force():
    structure = hysteretic()
    simulation = Simulation(12.0, 801)
    force = excitation(structure, 12.0, 801)
    measurements = Simulated(force, simulation, Noise(40.0)).measure(structure)
    truth = measurements.truth.response
    # An accelerometer does not tell where a structure with memory rests.
    problem = SparseRecovery(initial_motion="rest").pose(structure, [measurements.record.keep({"acceleration": [1]})])
    estimate = solved(problem)
    found, std = estimate.response, estimate.std
    assert np.all(fitness_percent(found.displacement, truth.displacement) > 97.0)
    assert np.all(fitness_percent(found.hidden, truth.hidden) > 95.0)
    assert inside(found.hidden, std.hidden, truth.hidden) > 0.8
    forces, stretched = connection_forces(structure, estimate, measurements.truth), drifts(structure, estimate, truth)
    assert np.all(fitness_percent(forces.of("estimate"), forces.of("true")) > 95.0)
    assert inside(*(forces.of(source) for source in ("estimate", "std", "true"))) > 0.85
    loops = [
        np.trapezoid(forces.of(source)[:, 1:], stretched.of(source)[:, 1:], axis=0) for source in ("estimate", "true")
    ]
    np.testing.assert_allclose(*loops, rtol=0.05)
    case = Case(estimate, measurements.record, measurements.truth, {})
    energy = dissipated_energy(results_of(case, prescribed=structure, true=structure))
    assert np.all(np.abs(energy.estimate - energy.true) < 3.0 * energy.std)
    assert np.all(energy.std < 0.1 * energy.true)


@pytest.mark.parametrize("frame", ["absolute", pytest.param("relative", marks=pytest.mark.slow)])
def test_the_ground(frame):
    structure, time = small_chain("linear"), np.linspace(0.0, 12.0, 601)
    shake = lambda t: sum(np.sin((2.0 + 1.3 * i) * np.asarray(t) + i * i) for i in range(7))  # noqa: E731
    nothing = lambda t: np.zeros((len(t), 3))  # noqa: E731
    truth = simulate(structure, nothing, time, substeps=8, ground=shake, frame=frame)
    noisy = Noise(40.0).added_to(truth)
    unforced = np.ones(3, dtype=bool)
    record = Record(**noisy.measurable, unforced=unforced, frame=frame).keep({"acceleration": [3]})
    estimate = solved(SparseRecovery(parameter_uncertainty=0.03).pose(structure, [record]))
    found, std = estimate.response, estimate.std
    for quantity in ("displacement", "velocity", "acceleration"):
        assert np.all(fitness_percent(getattr(found, quantity), getattr(truth, quantity)) > 97.0), quantity
    assert inside(found.displacement, std.displacement, truth.displacement) > 0.85
    assert fitness_percent(found.ground_acceleration[:, None], truth.ground_acceleration[:, None])[0] > 97.0
    assert inside(found.ground_acceleration, std.ground_acceleration, truth.ground_acceleration) > 0.85
    assert estimate.noise.sensors["ground_acceleration"][0] == pytest.approx(0.01 * np.std(shake(time)), rel=0.3)


def test_a_force_that_nobody_measured():
    structure = small_chain("linear")
    measurements = measured(structure, snr_db=40.0, samples=601)
    force = measurements.record.force.copy()
    force[:, 0] = np.nan
    record = replace(measurements.record.keep({"acceleration": [1, 2, 3]}), force=force)
    truth = measurements.truth.response
    estimate = solved(SparseRecovery(parameter_uncertainty=0.0).pose(structure, [record]))
    assert fitness_percent(estimate.response.force[:, :1], truth.force[:, :1])[0] > 95.0
    assert inside(estimate.response.force[:, 0], estimate.std.force[:, 0], truth.force[:, 0]) > 0.85
    free = solved(SparseRecovery(parameter_uncertainty=0.0, unknown_force="free").pose(structure, [record]))
    assert fitness_percent(free.response.force[:, :1], truth.force[:, :1])[0] < 90.0


def test_who_cannot_find_them_says_so_before_any_work():
    structure = hysteretic()
    measurements = Simulated(excitation(structure), Simulation(12.0, 257), Noise(40.0)).measure(structure)
    problem = SparseRecovery().pose(structure, [measurements.record])
    with pytest.raises(InputError, match="network.*spline.*hidden force"):
        TrainedNetwork(GaussNewton(), Mlp()).check(problem.alone)
