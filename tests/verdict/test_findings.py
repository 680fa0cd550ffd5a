"""Each number of an estimate that tells of trouble, made bad in an estimate that is right otherwise."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from frame_records import altered, measure, measurements
from small_estimates import other_estimate, parameter_estimate
from small_problems import measured

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.topology import build_structure
from pinn_cli.training.estimate import estimated_structure
from pinn_cli.training.noise_model import FoundNoise
from pinn_cli.verdict.parameter_findings import baseline_findings, parameter_findings
from pinn_cli.verdict.prediction import predicted
from pinn_cli.verdict.sensor_findings import noise_findings, random_structure, sensor_findings


def kinds(findings):
    return [(finding.kind, finding.suspect) for finding in findings]


def with_summary(estimate, **entries):
    return replace(estimate, summary=estimate.summary | entries)


def with_noise(estimate, sensors=(), **changes):
    """With other levels of sensors, by quantity, or of anything else."""
    every = {**estimate.noise.sensors, **{name: np.array(levels) for name, levels in dict(sensors).items()}}
    return replace(estimate, noise=replace(estimate.noise, sensors=every, **changes))


def with_parameter(given, names, **changes):
    """With one of some names, separated by spaces."""
    parameters = [other_estimate(p, **changes) if p.name in names.split() else p for p in given.parameters]
    return replace(given, parameters=parameters)


def of_parameters(problem, estimate):
    return kinds(parameter_findings(problem, estimate, estimated_structure(problem.structure, estimate.parameters)))


def of_sensors(problem, estimate):
    prediction = predicted(estimated_structure(problem.structure, estimate.parameters), problem.record)
    return kinds(sensor_findings(problem, estimate, prediction))


def test_a_right_estimate_has_none(frame, problem, estimate):
    """Nor has one of much white noise, or what the deviations of its parameters allow."""
    for record in (problem.record, measure(frame, 10.0)):
        assert noise_findings(replace(problem, record=record), estimate) == []
    assert of_sensors(problem, with_parameter(estimate, "k_1 k_2 k_3", estimate=15.5, std=1.0)) == []
    assert of_parameters(problem, estimate) == of_sensors(problem, estimate) == []
    assert baseline_findings(estimate, estimate, problem.record) == []


@pytest.mark.parametrize(
    ("share", "kind", "word"), [(1e-6, "noise_at_bound", "questionable"), (0.9, "nothing_explained", "failed")]
)
def test_noise_levels_that_were_not_found(problem, estimate, share, kind, word):
    sigma = [share * problem.record.acceleration[:, 0].std(), *estimate.noise.sensors["acceleration"][1:]]
    (found,) = noise_findings(problem, with_noise(estimate, {"acceleration": sigma}))
    assert (found.kind, found.suspect, found.word) == (kind, "acceleration of DOF 1", word)


def test_a_residual_with_a_band_of_its_own(problem, estimate):
    hum = np.sin(2 * np.pi * 0.8 * problem.record.time)
    record = altered(problem.record, 2, lambda x: x + 0.15 * x.std() * hum)
    (found,) = noise_findings(replace(problem, record=record), estimate)
    assert (found.kind, found.suspect) == ("not_white", "acceleration of DOF 2")
    assert "Hz" in found.text


@pytest.mark.parametrize(("share", "word"), [(0.3, "questionable"), (2.0, "failed")])
def test_a_discrepancy_of_the_size_of_the_force(problem, estimate, share, word):
    level = share * problem.record.force[:, 2].std()
    (found,) = noise_findings(problem, with_noise(estimate, discrepancy=level))
    assert (found.kind, found.word) == ("discrepancy", word)
    assert f"{100 * share:.0f} % of the measured force" in found.text


def test_a_channel_that_was_copied(problem, estimate):
    counts = {"acceleration": len(problem.record.time) * np.array([0.95, 0.92, np.nan])}
    force = problem.record.force[:, 2].std()
    open_to = {"taken": counts, "discrepancy": 0.1 * force}
    found = noise_findings(problem, with_noise(estimate, **open_to))
    assert kinds(found) == [("copied", "sensors")]
    # A lone accelerometer beside a poor load cell is rightly followed.
    assert noise_findings(problem, with_noise(estimate, {"force": [np.nan, np.nan, 0.2 * force]}, **open_to)) == []


def test_a_training_that_did_not_converge(problem, estimate):
    stopped = with_summary(estimate, stop_reason="iteration limit")
    assert kinds(noise_findings(problem, stopped)) == [("not_converged", "training")]
    without = replace(stopped, std=replace(estimate.std, displacement=np.nan * estimate.std.displacement))
    for shares, still in (
        ((1.0,) * 16, False),
        (0.9 ** np.arange(16), True),
        (1.0 + 0.2 * (np.arange(16) % 2), False),
    ):
        rows = {"loss_observation": 0.1 * np.asarray(shares), "loss_physics": 1e-3, "weight_observation": 1.0}
        history = pd.DataFrame(rows | {"weight_physics": np.repeat([1.0, 10.0], 8)})
        found = noise_findings(problem, replace(without, history=history))
        assert kinds(found) == ([("not_converged", "training")] if still else [])
        assert all("its loss was falling" in finding.text for finding in found)
    few = noise_findings(problem, replace(without, history=history.tail(3)))
    assert kinds(few) == [("not_converged", "training")]  # three rows do not say that it has settled


@pytest.mark.parametrize(("start", "word"), [(0.2, "questionable"), (1.5e7, "failed")])
def test_a_parameter_decades_from_what_was_said(problem, estimate, start, word):
    (found,) = parameter_findings(problem, with_parameter(estimate, "k_2", said=start), problem.structure)
    assert (found.kind, found.suspect, found.word) == ("parameter", "k_2", word)
    assert parameter_findings(problem, with_parameter(estimate, "k_2", said=1.0), problem.structure) == []
    # Where the program started is nobody's belief.
    elsewhere = with_parameter(estimate, "k_2", said=19.0, prescribed=start, positive=True, prior_std=10 * start)
    assert parameter_findings(problem, elsewhere, problem.structure) == []


def test_an_unknown_parameter_beyond_its_prior_at_zero_or_undetermined(problem, estimate):
    left = with_parameter(estimate, "k_2", prescribed=-1.0, prior_std=2.0, positive=False)
    assert of_parameters(problem, left) == [("parameter", "k_2")]
    (found,) = parameter_findings(problem, with_parameter(estimate, "k_1", estimate=0.0), problem.structure)
    assert (found.suspect, "ended at zero" in found.text) == ("k_1", True)
    held = with_parameter(estimate, "k_1", estimate=0.0, held=True)
    (found,) = parameter_findings(problem, held, problem.structure)
    assert (found.kind, found.suspect) == ("not_identified", "k_1")
    assert of_parameters(problem, with_parameter(estimate, "k_1", std=3.0)) == [("not_identified", "k_1")]
    rough = replace(problem, uncertain=(Parameter("kappa", 0, 1.0, 1.0, unknown=True),))
    named = with_parameter(estimate, "k_1", kind="kappa", std=3.0)
    assert kinds(parameter_findings(rough, named, problem.structure)) == []
    gain = {"kind": "gain", "positive": False, "prescribed": 1.0, "prior_std": 10.0}
    none = with_parameter(estimate, "k_2", **gain, estimate=0.01, std=0.1)
    assert of_parameters(problem, none) == [("not_identified", "gain_2")]


@pytest.mark.parametrize(
    ("start", "value", "std", "prior_std", "told"),
    [
        (0.0, 3e-6, 7e-6, 0.55, ""),  # an offset, V, beside a signal of 55 mV
        (3e-4, 3e-6, 7e-6, 0.55, ""),  # which the record's mean did not start at
        (0.0, 0.0, 7e-6, 0.55, ""),
        (0.0, 3e-3, 7e-3, 0.55, "is 13 % of its order of magnitude, 0.055"),
        (0.0, -0.2, 0.15, 0.55, "is 75 % of its value"),
        (0.0, 3.0, 0.1, 0.55, "prior standard deviations from its start"),
    ],
)
def test_what_may_be_zero_is_judged_beside_the_signal(problem, estimate, start, value, std, prior_std, told):
    offset = {"kind": "offset", "positive": False, "prescribed": start, "prior_std": prior_std}
    given = with_parameter(estimate, "k_2", **offset, estimate=value, std=std)
    found = parameter_findings(problem, given, problem.structure)
    assert len(found) == bool(told)
    assert all(told in finding.text for finding in found)


@pytest.mark.parametrize(("away", "told"), [(-3.0, False), (-9.0, True)])
def test_a_bound_that_the_record_contradicts(problem, estimate, away, told):
    count = len(estimate.parameters)
    mean, nothing = np.array([p.estimate for p in estimate.parameters]), np.zeros(count)
    mean[1] = 0.01 * away
    known = ParameterKnowledge(mean, 1e-4 * np.eye(count), nothing, nothing, np.ones(count))
    found = of_parameters(problem, replace(estimate, known=known))
    assert found == ([("bound", "k_2")] if told else [])


def test_prescribed_parameters_that_moved(problem, estimate):
    moved = with_parameter(estimate, "c_3", estimate=1.4)
    assert of_parameters(problem, moved) == [("moved", "c_3")]
    assert of_parameters(problem, with_summary(estimate, parameter_spread=9.0)) == [("spread", "parameters")]


@pytest.mark.parametrize(
    ("scale", "told"), [(1e4, "above the Nyquist"), (1e-6, "below one period"), (-1.0, "unstable")]
)
def test_natural_frequencies_that_the_record_cannot_hold(problem, estimate, scale, told):
    structure = problem.structure.with_parameters(k=problem.structure.parameters["k"] * scale)
    found = parameter_findings(problem, estimate, structure)
    assert any(f.kind == "frequencies" and told in f.text and f.word == "failed" for f in found)


def test_sensors_that_the_free_run_does_not_reproduce(problem, estimate):
    found = of_sensors(problem, with_parameter(estimate, "k_1 k_2 k_3", estimate=18.0))
    assert found == [("free_run", f"acceleration of DOF {dof}") for dof in (1, 2, 3)]


@pytest.mark.parametrize("seed", [6, 11])  # of 20, those that two draws alone did not excuse
def test_a_motion_that_is_nearly_chaotic_may_part_from_itself_later_in_most_draws(estimate, seed):
    """By its force a cubic spring is eight times the linear one: a ten-thousandth of it is found by the end."""
    structure = build_chain(1, Duffing(), m=10.0, c=0.3, k=15.0, kappa=1000.0)
    simulated = measurements(structure, 90.0, 10.0)
    record, truth = simulated.record.keep({"acceleration": (1,)}), simulated.truth.response
    std = Response(record.time, *(np.full(truth.force.shape, 1e-3 * np.std(truth.displacement)) for _ in range(4)))
    random, parameters = np.random.default_rng(seed), []
    for name, value in (("k_1", 15.0), ("kappa_1", 1000.0)):
        deviation = 1e-4 * value
        found = value + deviation * random.standard_normal()
        parameters.append(parameter_estimate(name, 10.0, found, deviation, 0.99 * value, 1.01 * value, 100.0, True))
    levels = {of: np.std(getattr(record, of) - getattr(truth, of), axis=0) for of in ("force", "acceleration")}
    nearly = replace(estimate, response=truth, std=std, parameters=parameters, noise=FoundNoise(levels, 1e-4))
    unknown = tuple(Parameter(kind, 0, 10.0, 100.0, unknown=True) for kind in ("k", "kappa"))
    assert of_sensors(Problem(structure, record, unknown), nearly) == []


def test_an_unstable_chain_has_no_free_run(problem, estimate):
    unstable = with_parameter(estimate, "c_2", estimate=-5.0)
    assert of_sensors(problem, unstable) == [("free_run", "model")]
    unknown = replace(problem.record, force=np.full_like(problem.record.force, np.nan), unforced=np.zeros(3, bool))
    assert sensor_findings(replace(problem, record=unknown), unstable, None) == []


def test_random_chains_scatter_by_the_standard_deviations(problem, estimate):
    random = np.random.default_rng(0)
    k = np.array([random_structure(problem, estimate, random).parameters["k"].numpy() for _ in range(400)])
    assert k.mean(axis=0) == pytest.approx(15.0, abs=0.003)
    assert k.std(axis=0) == pytest.approx(0.01, rel=0.2)


def test_a_baseline_that_differs(problem, estimate):
    other = with_parameter(estimate, "k_2", estimate=16.0)
    assert kinds(baseline_findings(estimate, other, problem.record)) == [("baseline", "k_2")]
    assert baseline_findings(estimate, with_parameter(other, "k_2", std=0.5), problem.record) == []
    displacement = estimate.response.displacement * np.array([1.0, 1.0, 1.5])
    moved = replace(estimate, response=replace(estimate.response, displacement=displacement))
    assert kinds(baseline_findings(estimate, moved, problem.record)) == [("baseline", "displacement of DOF 3")]
    assert baseline_findings(estimate, None, problem.record) == []


SPRING = {"between": ["a", "b"], "law": "linear", "c": 1.0, "k": 15.0}
FREE = build_structure(["a", "b"], 10.0, {"spring": SPRING})
HELD = build_structure(["a", "b"], 10.0, {"spring": SPRING, "foot": {**SPRING, "between": ["ground", "a"]}})


@pytest.mark.parametrize(
    ("structure", "sensor", "told"),
    [(FREE, "acceleration", ["held"]), (FREE, "displacement", []), (HELD, "acceleration", [])],
)
def test_a_free_body_is_told_by_its_names_and_is_no_fault(right_estimate, structure, sensor, told):
    """Where a displacement sensor is on it, nothing is open."""
    found = measured(structure, duration=20.0, samples=401)
    record = replace(found.record, dofs=("a", "b")).keep({sensor: [1, 2]})
    problem = SparseRecovery().pose(structure, [record]).alone
    findings = parameter_findings(problem, replace(right_estimate[1], parameters=[]), structure)
    assert [(f.kind, f.word) for f in findings] == [(kind, "sound") for kind in told]
    assert all("not held: DOFs a, b can move as a rigid body" in f.text for f in findings)
    truth = found.truth.response.displacement
    response = predicted(structure, found.record).response.displacement
    if told:
        np.testing.assert_allclose(response, truth, atol=1e-3 * np.ptp(truth))
