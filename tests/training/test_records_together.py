"""Several records solved together: here or in other processes, what each has of the whole, and whether they agree."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from one_record import by_spline
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.runs import side_by_side
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.history import History
from pinn_cli.training.least_squares import joined_parameters
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.reported.posterior_estimate import own_information, posterior_estimate
from pinn_cli.training.solver import starting_noise
from pinn_cli.verdict.judge import APART, contradictions

STIFFNESSES = tuple(Parameter("k", i, 15.0, 150.0, unknown=True, positive=True) for i in range(2))
DAMPER = Parameter("c", 1, 1.0, 0.3)


def records() -> list[Record]:
    """Two of one chain, of different lengths, each with an accelerometer of its own."""
    structure = small_chain("duffing", 2)
    lengths = ((8.0, 129), (12.0, 161))
    every = [measured(structure, "exact", 40.0, *length, seed=i).record for i, length in enumerate(lengths)]
    return [accelerations(record, (dof,)) for record, dof in zip(every, (1, 2), strict=True)]


def together(uncertain: tuple[tuple[Parameter, ...], ...], here: bool = True) -> tuple[Evidence, NoiseLevels]:
    """Both records, each with its own uncertain parameters, computed in this process or in copies of it."""
    structure = small_chain("duffing", 2)
    own = [Problem(structure, record, moving) for record, moving in zip(records(), uncertain, strict=True)]
    each = [NormalEquations(Spline(knots_per_period=4.0).build(p.record), p) for p in own]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(side_by_side, "usable_cores", lambda: [0] if here else [0, 1])
        evidence = Evidence(each, 20, 1e-9, lambda losses, noise: None)
    assert (type(evidence.equations.members) is side_by_side.Items) == here
    levels = (replace(starting_noise(own), discrepancy=0.02) for own in each)
    return evidence, NoiseLevels(tuple(levels), spread=0.8)


SHARED = ((*STIFFNESSES, DAMPER),) * 2
# The first record alone lets the damper move, the second one alone the first spring.
PARTLY = ((STIFFNESSES[1], DAMPER), STIFFNESSES)


@cache
def solved(uncertain: tuple[tuple[Parameter, ...], ...], here: bool = True) -> tuple[Evidence, NoiseLevels, Trained]:
    evidence, noise = together(uncertain, here)
    return evidence, noise, evidence.train(noise, evidence.equations.start())


def motion_std(evidence: RecordEvidence, solution: RecordSolution) -> np.ndarray:
    """Of a file's, so that a copy of the process finds it."""
    equations = evidence.equations
    posterior = ReadoutPosterior(equations, solution.point, solution.factor)
    return posterior.functions(equations.observation)[0].numpy()


def test_the_numbers_do_not_depend_on_where_they_are_computed():
    found = []
    for here in (True, False):
        evidence, _, trained = solved(SHARED, here)
        found.append((trained, evidence.each_record(motion_std, trained)))
    (one, one_std), (other, other_std) = found
    assert torch.equal(one.solution.point.parameters, other.solution.point.parameters)
    assert torch.equal(one.solution.point.unknowns, other.solution.point.unknowns)
    assert one.log_evidence == other.log_evidence
    assert all(np.array_equal(a, b) for a, b in zip(one_std, other_std, strict=True))


def test_records_that_believe_different_things_of_a_parameter_are_refused():
    other = (*STIFFNESSES, replace(DAMPER, prior_std=0.5))
    with pytest.raises(ValueError, match="believe the same"):
        together((SHARED[0], other))


def sensor(kind: str, index: int, name: str) -> Parameter:
    return Parameter(kind, index, 1.0, 2.0, unknown=True, label=name)


def test_gain_and_delay_go_with_the_sensor_and_its_offset_with_the_record():
    """Sensors are known by name: their number among the channels of another record may be another one."""
    first = (STIFFNESSES[0], sensor("gain", 0, "f"), sensor("offset", 0, "f"), sensor("delay", 1, "a1"))
    second = (STIFFNESSES[0], sensor("offset", 1, "f"), sensor("gain", 1, "f"), sensor("delay", 0, "a2"))
    every, columns = joined_parameters([first, second])
    names = ["k_1", "gain_f", "offset_f", "delay_a1", "offset_f_record_2", "delay_a2"]
    assert [p.name for p in every] == names
    assert [list(places) for places in columns] == [[0, 1, 2, 3], [0, 4, 1, 5]]
    assert every[: len(first)] == first


@pytest.mark.parametrize("uncertain", [SHARED, PARTLY])
def test_the_estimate_has_all_parameters_and_every_record_its_own(uncertain):
    evidence, _, trained = solved(uncertain)
    estimate = posterior_estimate(evidence, trained, History(progress=False))
    every = {found.name: found for found in estimate.parameters}
    assert set(every) == {"k_1", "k_2", "c_2"}
    assert len(estimate.by_record) == 2
    for own, moving, record in zip(estimate.by_record, uncertain, records(), strict=True):
        assert tuple(found.parameter for found in own.parameters) == moving
        assert all(found.estimate == every[found.name].estimate for found in own.parameters)
        assert own.correlation.shape == (len(moving),) * 2
        assert len(own.response.time) == len(record.time)
        assert not own.records
    places = [list(every).index(found.name) for found in estimate.by_record[1].parameters]
    np.testing.assert_array_equal(estimate.by_record[1].correlation, estimate.correlation[np.ix_(places, places)])
    deviations = [every[name].std for name in every]
    alone = np.sqrt(np.diag(trained.factor.corner_covariance)) * evidence.equations.scale
    assert np.all(np.array(deviations) >= 0.98 * alone)


def test_pulls_of_all_records_balance_the_prior() -> None:
    """At the most probable parameters the slopes of all records' misfits and of the prior add up to none."""
    evidence, noise, trained = solved(SHARED)
    each = evidence.each_record(own_information, trained)
    at = trained.solution.point.parameters.numpy()
    prior = evidence.equations.precision(noise).numpy() * at
    size = np.sqrt(sum(np.diag(information) for information, _ in each))
    np.testing.assert_allclose(sum(pull for _, pull in each) / size, prior / size, atol=2e-2)
    assert max(np.abs(pull / size).max() for _, pull in each) > 0.1
    for information, _ in each:
        assert np.linalg.eigvalsh(information / np.outer(size, size)).min() > -1e-8


@cache
def of_springs(second_k: float) -> Estimate:
    """Two records with sensors on every DOF, the second of a chain with other springs."""
    every = [
        measured(small_chain("linear", 2, k=k), snr_db=30.0, duration=24.0, samples=385, seed=seed).record
        for seed, k in enumerate((15.0, second_k))
    ]
    scheme = StateParameter(unknown=["k_*"], parameter_uncertainty=0.0)
    return by_spline(scheme.pose(small_chain("linear", 2), every))


def test_records_of_one_structure_agree_within_chance():
    found = of_springs(15.0)
    assert [d.freedom for d in found.disagreements] == [2, 2]
    for one in found.disagreements:
        assert one.square < 15.0  # of a chi-square of two: one in 1800
        assert list(one.alone) == ["k_1", "k_2"]
        for name, value in one.alone.items():
            assert value == pytest.approx(15.0, rel=0.03), name
    assert not contradictions(found)
    assert not found.by_record[0].disagreements


@pytest.mark.slow
def test_a_record_of_another_structure_contradicts_the_rest():
    found = of_springs(18.0)
    assert max(d.square for d in found.disagreements) > 2.0 * APART**2
    (finding,) = contradictions(found)
    assert (finding.kind, finding.word) == ("contradiction", "questionable")
    assert "contradicts the other one: by itself it says k_" in finding.text
    assert "\n" not in finding.text


@pytest.mark.parametrize(("off", "told"), [(1.01, False), (1.05, True)])
def test_a_pull_beyond_chance_needs_a_difference_that_is_worth_a_word(off, told):
    found = of_springs(15.0)
    alone = {p.name: off * p.estimate for p in found.parameters}
    first, second = found.disagreements
    pulling = replace(second, square=1e4, alone=alone)
    assert bool(contradictions(replace(found, disagreements=(first, pulling)))) == told
