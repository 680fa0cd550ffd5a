"""Every estimator on any structure, under forces that nobody measured and on moving ground: motion, forces, bands."""

from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest
from ambient_records import AmbientRecord, ambient_record, frame, storeys
from one_record import by_spline
from small_estimates import Case, results_of
from small_problems import excitation, measured, small_chain
from storeys import chain_matrix
from structures import braced, hysteretic, shuffled

from pinn_cli.baseline.kalman_smoother import KalmanSmoother
from pinn_cli.network.mlp import Mlp
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation, simulate
from pinn_cli.report.estimates import connection_forces, dissipated_energy, drifts
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.system.topology import build_structure
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.noise_model import FoundNoise
from pinn_cli.training.whittle.whittle_estimate import known_parameters
from pinn_cli.verdict.input_findings import input_findings
from pinn_cli.verdict.judge import judge
from pinn_cli.verdict.sensor_findings import noise_findings


def solved(made, uncertainty=0.0):
    problem = SparseRecovery(parameter_uncertainty=uncertainty).pose(made.structure, [made.record])
    return problem, by_spline(problem)


def unsolved(made: AmbientRecord, **summary) -> Estimate:
    """An estimate of the truth with nothing but this summary."""
    return Estimate(made.truth, made.truth, [], pd.DataFrame(), summary)


def inside(estimate: np.ndarray, std: np.ndarray, truth: np.ndarray) -> float:
    """Share of the truth within 1.96 standard deviations."""
    return float(np.mean(np.abs(estimate - truth) < 1.96 * std))


@pytest.mark.parametrize(
    ("first_frequency", "rate", "duration", "edge"),
    [(4.0, 100.0, 5.0, 25.0), (4.0, 50.0, 5.0, None), (1.0, 50.0, 14.0, None)],
    ids=["forces far below the Nyquist frequency", "forces up to it", "forces far above the structure"],
)
def test_motion_and_forces_with_their_bands(first_frequency, rate, duration, edge):
    made = ambient_record(first_frequency, rate, duration, edge, seed=2)
    problem, estimate = solved(made)
    found, std, truth = estimate.response, estimate.std, made.truth
    assert np.all(fitness_percent(found.displacement, truth.displacement)[[0, 2]] > 80.0)  # slow drift included
    for quantity in ("displacement", "velocity", "acceleration", "force"):
        held = inside(*(getattr(x, quantity) for x in (found, std, truth)))
        assert 0.88 < held < 0.997, (quantity, held)
    # Flat forces come out as large as they are, and are not taken for the sensors' noise.
    assert estimate.summary["std_unknown_force"] == pytest.approx(truth.force.std(), rel=0.2)
    sigma = estimate.noise.sensors["acceleration"]
    sigma = sigma[np.isfinite(sigma)]
    assert np.all((sigma > 0.5 * made.noise) & (sigma < 4.0 * made.noise))
    assert judge(problem.alone, estimate).word == "sound"


@pytest.mark.slow
def test_the_colour_of_forces_is_found_and_the_bands_are_as_wide_as_the_errors():
    squares = []
    for seed in range(4):
        made = ambient_record(3.0, 100.0, 10.0, 40.0, corner=1.5, seed=seed)
        _, estimate = solved(made)
        time = estimate.summary["correlation_time_unknown_force"]
        assert time == pytest.approx(1.0 / (2.0 * np.pi * 1.5), rel=0.7)
        error = estimate.response.displacement - made.truth.displacement
        squares.append(np.mean((error / estimate.std.displacement) ** 2))
    assert 0.7 < np.mean(squares) ** 0.5 < 1.2  # slow motion is but few values in ten seconds


def test_uncertain_parameters_come_from_the_spectra_and_the_motion_allows_for_them():
    made = ambient_record(4.0, 100.0, 20.0, 25.0, floors=2, sensors=(0, 1))
    problem, estimate = solved(made, uncertainty=0.05)
    off = [(p.estimate - p.prescribed) / p.std for p in estimate.parameters]  # what is prescribed is the truth
    assert np.max(np.abs(off)) < 3.0
    assert all(abs(p.estimate / p.prescribed - 1.0) < 0.02 for p in estimate.parameters if p.kind == "k")
    held = inside(estimate.response.displacement, estimate.std.displacement, made.truth.displacement)
    assert 0.88 < held < 0.999
    assert judge(problem.alone, estimate).word == "sound"


@pytest.mark.slow
@pytest.mark.parametrize(("first_frequency", "seed"), [(4.0, 0), (1.5, 1)])
def test_springs_and_dampers_without_a_start_come_from_the_resonances(first_frequency, seed):
    made = ambient_record(first_frequency, 50.0, 60.0, 20.0, seed=seed)
    names, connections = storeys(*[{"law": "linear", "c": None, "k": None}] * 3)
    masses = dict(zip(names, made.structure.parameters["m"].tolist(), strict=True))
    nothing = build_structure(names, masses, connections)
    problem = StateParameter(unobserved=[], unknown="missing").pose(nothing, [made.record])
    estimate = by_spline(problem)
    for p in estimate.parameters:
        truth = float(made.structure.parameters[p.kind][p.parameter.index])
        assert p.estimate == pytest.approx(truth, rel={"k": 0.05, "c": 0.5}[p.kind])
        assert abs(p.estimate - truth) < 4.0 * p.std
    assert judge(problem.alone, estimate).word == "sound"


def test_a_sensor_of_another_scale_than_it_says_makes_uncertain_parameters_questionable():
    made = ambient_record(4.0, 50.0, 60.0, 15.0)
    scaled = made.record.acceleration * np.array([1.0, np.nan, 1.3])
    problem = SparseRecovery(parameter_uncertainty=0.1).pose(
        made.structure, [replace(made.record, acceleration=scaled)]
    )
    known = known_parameters(problem)
    found = input_findings(problem.alone, unsolved(made, spectral_misfit=known.misfit), made.structure)
    assert any(finding.kind == "spectra" and finding.word == "questionable" for finding in found)
    right = known_parameters(SparseRecovery(parameter_uncertainty=0.1).pose(made.structure, [made.record]))
    assert right.misfit == 0.0


def test_uncertain_parameters_beside_a_nonlinear_connection_are_questionable_beside_the_likeliest_forces():
    made = ambient_record(4.0, 50.0, 20.0, 15.0)
    laws = {"law": "duffing", "kappa": 1.0}, {"law": "linear"}, {"law": "linear"}
    values = zip(*(made.structure.parameters[kind].tolist() for kind in ("c", "k")), laws, strict=True)
    names, connections = storeys(*({"c": c, "k": k, **law} for c, k, law in values))
    bent = build_structure(names, dict.fromkeys(names, 1000.0), connections)
    pushed = np.full_like(made.record.force, np.nan)
    pushed[:, 0] = made.truth.force[:, 0]
    problem = SparseRecovery(parameter_uncertainty=0.1).pose(bent, [replace(made.record, force=pushed)])
    assert known_parameters(problem) is None
    found = input_findings(problem.alone, unsolved(made), bent)
    assert any(finding.kind == "output_only_parameters" for finding in found)
    # With the forces integrated out, beside masses on which none acts: a spring between two that carry one is not held.
    integrated = unsolved(made, at_marginal_peak=True)
    between, every = "c_storey_2, k_storey_2", "parameters"
    for on, told in (((2,), []), ((1, 2), [between]), ((0, 1, 2), [every])):
        some = np.zeros_like(made.record.force)
        some[:, on] = np.nan
        felt = replace(made.record, acceleration=made.truth.acceleration, force=some, unforced=~np.isin(range(3), on))
        problem = SparseRecovery(parameter_uncertainty=0.1).pose(bent, [felt]).alone
        found = input_findings(problem, integrated, bent)
        assert [finding.suspect for finding in found if finding.kind == "output_only_parameters"] == told
    # Where the forces have the spectrum that the record shows, this holds them: forces on all DOFs, each with a sensor.
    for misfit, told in ((0.1, []), (0.5, [every])):
        shown = unsolved(made, at_marginal_peak=True, misfit_unknown_force=misfit)
        found = input_findings(problem, shown, bent)
        assert [finding.suspect for finding in found if finding.kind == "output_only_parameters"] == told
    known = SparseRecovery(parameter_uncertainty=0.0).pose(bent, [replace(made.record, force=pushed)])
    found = input_findings(known.alone, unsolved(made), bent)
    assert not any(finding.kind == "output_only_parameters" for finding in found)


@pytest.mark.parametrize(("measured", "free"), [((1,), True), ((0, 1), False)])
def test_sensors_are_rightly_followed_where_as_many_forces_are_unknown(measured, free):
    made = ambient_record(4.0, 50.0, 10.0, 15.0)
    pushed = np.full_like(made.record.force, np.nan)
    pushed[:, measured] = made.truth.force[:, measured]
    problem = SparseRecovery(parameter_uncertainty=0.0).pose(made.structure, [replace(made.record, force=pushed)])
    samples = float(len(made.record.time))
    noise = FoundNoise(taken={"acceleration": np.array([samples, np.nan, samples])})
    found = noise_findings(problem.alone, replace(unsolved(made), noise=noise))
    assert free != any(finding.kind == "copied" for finding in found)


@pytest.mark.slow
def test_a_hidden_force():
    structure = hysteretic()
    simulation = Simulation(12.0, 801)
    force = excitation(structure, 12.0, 801)
    measurements = Simulated(force, simulation, Noise(40.0)).measure(structure)
    truth = measurements.truth.response
    # An accelerometer does not tell where a structure with memory rests.
    problem = SparseRecovery(initial_motion="rest").pose(structure, [measurements.record.keep({"acceleration": [1]})])
    estimate = by_spline(problem)
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
    estimate = by_spline(SparseRecovery(parameter_uncertainty=0.03).pose(structure, [record]))
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
    estimate = by_spline(SparseRecovery(parameter_uncertainty=0.0).pose(structure, [record]))
    assert fitness_percent(estimate.response.force[:, :1], truth.force[:, :1])[0] > 95.0
    assert inside(estimate.response.force[:, 0], estimate.std.force[:, 0], truth.force[:, 0]) > 0.85
    free = by_spline(SparseRecovery(parameter_uncertainty=0.0, unknown_force="free").pose(structure, [record]))
    assert fitness_percent(free.response.force[:, :1], truth.force[:, :1])[0] < 90.0


def test_who_cannot_find_them_says_so_before_any_work():
    structure = hysteretic()
    measurements = Simulated(excitation(structure), Simulation(12.0, 257), Noise(40.0)).measure(structure)
    problem = SparseRecovery().pose(structure, [measurements.record])
    with pytest.raises(InputError, match="network.*spline.*hidden force"):
        TrainedNetwork(GaussNewton(), Mlp()).check(problem.alone)


ESTIMATORS = {
    "spline": by_spline,
    "mlp": lambda problem: GaussNewton().solve(problem, Mlp(1, None, "sine", embedding="fourier"), RunContext()),
    "smoother": lambda problem: KalmanSmoother().solve(problem, RunContext()),
}


STRUCTURES = {"braced": braced(), "shuffled": shuffled(4)}
LONG = {("braced", "mlp"): pytest.mark.slow}


@pytest.mark.parametrize(
    ("name", "estimator"), [pytest.param(*x, marks=LONG.get(x, ())) for x in product(STRUCTURES, ESTIMATORS)]
)
def test_the_motion_of_a_mass_without_a_sensor(name, estimator):
    structure = STRUCTURES[name]
    measurements = measured(structure, "exact", snr_db=40.0, duration=12.0, samples=601)
    scheme = SparseRecovery(unobserved=[structure.ndof])
    problem = scheme.pose(structure, [scheme.observe(measurements.record)])
    found, truth = ESTIMATORS[estimator](problem).response, measurements.truth.response
    for quantity in ("displacement", "velocity", "acceleration"):
        scores = fitness_percent(getattr(found, quantity), getattr(truth, quantity))
        assert np.all(scores > 98.0), (quantity, scores)


FIRST, RATE, DURATION, EDGE, CORNER = 8.0, 400.0, 10.0, 40.0, 4.0


def closed_form_deviation(noise: float) -> float:
    """Of the displacement, rms over all floors and times: a linear structure's Gaussian posterior, line by line, m."""
    (m, c, k), total, step = frame(2, FIRST), 0.0, 1.0 / DURATION
    flat = 100.0**2 / (CORNER * np.arctan(EDGE / CORNER))  # one-sided, N^2/Hz: forces have 100 N rms
    for frequency in np.arange(step, 0.5 * RATE, step):
        omega = 2.0 * np.pi * frequency
        receptance = np.linalg.inv(chain_matrix(k) - omega**2 * np.diag(m) + 1j * omega * chain_matrix(c))
        force = flat / (1.0 + (frequency / CORNER) ** 2) * (1.0 if frequency <= EDGE else 1e-6)
        prior = np.linalg.inv(receptance @ receptance.conj().T * force)
        known = np.linalg.inv(prior + omega**4 / (2.0 * noise**2 / RATE) * np.eye(2))
        total += np.trace(known).real * step / 2.0
    return float(np.sqrt(total))


def test_bands_of_slow_motion_under_coloured_forces_are_as_wide_as_accelerometers_leave_it():
    made = ambient_record(FIRST, RATE, DURATION, EDGE, corner=CORNER, floors=2, sensors=(0, 1), seed=3)
    problem = SparseRecovery(parameter_uncertainty=0.0).pose(made.structure, [made.record])
    estimate = by_spline(problem)
    found = float(np.sqrt(np.mean(estimate.std.displacement**2)))
    assert 0.7 < found / closed_form_deviation(made.noise) < 1.6
