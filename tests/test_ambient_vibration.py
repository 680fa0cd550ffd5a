"""Frames under forces that nobody measured: motion, forces and bands, on records that scipy made."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from ambient_records import ambient_record
from solved_records import by_spline

from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.topology import build_partial_structure, build_structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.found_noise import FoundNoise
from pinn_cli.training.whittle.whittle_estimate import known_parameters
from pinn_cli.verdict.input_findings import input_findings
from pinn_cli.verdict.judge import judge
from pinn_cli.verdict.sensor_findings import noise_findings


def solved(made, uncertainty=0.0):
    problem = SparseRecovery(parameter_uncertainty=uncertainty).pose(made.structure, [made.record])
    return problem, by_spline(problem)


def inside(estimate, std, truth):
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
    names = [f"x{i}" for i in range(3)]
    connections = {
        f"storey_{i}": {"between": ["ground", *names][i : i + 2], "law": "linear", "c": None, "k": None}
        for i in range(3)
    }
    masses = dict(zip(names, made.structure.parameters["m"].tolist(), strict=True))
    nothing = build_partial_structure(names, masses, connections)
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
    estimate = Estimate(made.truth, made.truth, [], pd.DataFrame(), {"spectral_misfit": known.misfit})
    found = input_findings(problem.alone, estimate, made.structure)
    assert any(finding.kind == "spectra" and finding.word == "questionable" for finding in found)
    right = known_parameters(SparseRecovery(parameter_uncertainty=0.1).pose(made.structure, [made.record]))
    assert right.misfit == 0.0


def test_uncertain_parameters_beside_a_nonlinear_connection_are_questionable_beside_the_likeliest_forces():
    made = ambient_record(4.0, 50.0, 20.0, 15.0)
    names, connections = ["x0", "x1", "x2"], {}
    for i, (c, k) in enumerate(zip(*(made.structure.parameters[kind].tolist() for kind in ("c", "k")), strict=True)):
        own = {"between": ["ground", *names][i : i + 2], "c": c, "k": k}
        connections[f"storey_{i}"] = own | ({"law": "duffing", "kappa": 1.0} if i == 0 else {"law": "linear"})
    bent = build_structure(names, dict.fromkeys(names, 1000.0), connections)
    pushed = np.full_like(made.record.force, np.nan)
    pushed[:, 0] = made.truth.force[:, 0]
    problem = SparseRecovery(parameter_uncertainty=0.1).pose(bent, [replace(made.record, force=pushed)])
    assert known_parameters(problem) is None
    found = input_findings(problem.alone, Estimate(made.truth, made.truth, [], pd.DataFrame(), {}), bent)
    assert any(finding.kind == "output_only_parameters" for finding in found)
    # With the forces integrated out, beside masses on which none acts: a spring between two that carry one is not held.
    summary = {"at_marginal_peak": True}
    integrated = Estimate(made.truth, made.truth, [], pd.DataFrame(), summary)
    between, every = "c_storey_2, k_storey_2", "parameters"
    for on, told in (((2,), []), ((1, 2), [between]), ((0, 1, 2), [every])):
        some = np.zeros_like(made.record.force)
        some[:, on] = np.nan
        felt = replace(made.record, acceleration=made.truth.acceleration, force=some, unforced=~np.isin(range(3), on))
        problem = SparseRecovery(parameter_uncertainty=0.1).pose(bent, [felt]).alone
        found = input_findings(problem, integrated, bent)
        assert [finding.suspect for finding in found if finding.kind == "output_only_parameters"] == told
    known = SparseRecovery(parameter_uncertainty=0.0).pose(bent, [replace(made.record, force=pushed)])
    found = input_findings(known.alone, Estimate(made.truth, made.truth, [], pd.DataFrame(), {}), bent)
    assert not any(finding.kind == "output_only_parameters" for finding in found)


@pytest.mark.parametrize(("measured", "free"), [((1,), True), ((0, 1), False)])
def test_sensors_are_rightly_followed_where_as_many_forces_are_unknown(measured, free):
    made = ambient_record(4.0, 50.0, 10.0, 15.0)
    pushed = np.full_like(made.record.force, np.nan)
    pushed[:, measured] = made.truth.force[:, measured]
    problem = SparseRecovery(parameter_uncertainty=0.0).pose(made.structure, [replace(made.record, force=pushed)])
    samples = float(len(made.record.time))
    noise = FoundNoise(taken={"acceleration": np.array([samples, np.nan, samples])})
    found = noise_findings(problem.alone, Estimate(made.truth, made.truth, [], pd.DataFrame(), {}, noise=noise))
    assert free != any(finding.kind == "copied" for finding in found)
