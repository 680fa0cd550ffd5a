"""A search in a part of a long record ends where a search in all of it does."""

from dataclasses import replace

import numpy as np
import pytest
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.history import History
from pinn_cli.training.inference import infer
from pinn_cli.training.solver import Inference, Solver
from pinn_cli.training.steps import discrepancy_search, part_of_record

SAMPLES, DURATION = 1500, 72.0
UNCERTAIN = (
    Parameter("k", 0, 12.0, 120.0, unknown=True),
    Parameter("k", 1, 15.0, 1.125),
    Parameter("c", 2, 1.0, 0.075),
)


@pytest.fixture(scope="module")
def problem() -> Problem:
    record = measured(small_chain("linear"), snr_db=40.0, duration=DURATION, samples=SAMPLES).record
    return Problem(small_chain("linear"), accelerations(record, (1, 2, 3)), UNCERTAIN)


def solved(problem: Problem) -> tuple[Inference, History]:
    history = History(False)
    return infer(JointProblem.of(problem), Solver((Spline(),), history)), history


def in_parts(monkeypatch, samples: int = 400) -> None:
    monkeypatch.setattr(part_of_record, "FEWEST_SAMPLES", samples)


def test_it_ends_where_a_search_in_all_of_the_record_ends(problem, monkeypatch):
    whole, _ = solved(problem)
    in_parts(monkeypatch)
    searched = []
    for module in (discrepancy_search, part_of_record):
        scan = module.scanned
        noted = lambda own, *a, scan=scan, **k: searched.append(own.problem.alone.record) or scan(own, *a, **k)  # noqa: E731
        monkeypatch.setattr(module, "scanned", noted)
    found, _ = solved(problem)
    assert len(searched) == 2
    assert len(searched[0].time) < 500
    factor, other = whole.trained.factor, found.trained.factor
    std, other_std = (np.sqrt(np.diag(x.corner_covariance)) for x in (factor, other))
    np.testing.assert_allclose(other_std, std, rtol=0.05)
    apart = found.trained.solution.point.parameters - whole.trained.solution.point.parameters
    assert np.all(np.abs(apart.numpy()) < 0.1 * std)
    (noise,), (again,) = whole.trained.noise.records, found.trained.noise.records
    np.testing.assert_allclose(again.response["acceleration"], noise.response["acceleration"], rtol=0.05)
    assert found.trained.log_evidence == pytest.approx(whole.trained.log_evidence, abs=1.0)


def test_the_part_has_the_same_knots_and_whole_samples(problem, monkeypatch):
    in_parts(monkeypatch)
    network = Spline().build(problem.record)
    own, fewer = part_of_record.part_of_record(JointProblem.of(problem), network)
    assert fewer.spacing == pytest.approx(network.spacing)
    assert fewer.start == network.start
    samples = len(own.record.time)
    assert 400 <= samples < 500
    np.testing.assert_array_equal(own.record.acceleration, problem.record.acceleration[:samples])
    # Behind the last sample the part ends as far as the whole does, but for what the whole's last interval has over.
    over = network.stop - problem.record.time[-1]
    assert 0.0 < fewer.stop - own.record.time[-1] <= over + 1e-9


def shaken_later(record: Record) -> Record:
    return replace(record, force=record.force * np.where(np.arange(SAMPLES) < 400, 0.1, 1.0)[:, None])


def test_some_records_are_searched_whole(problem, monkeypatch):
    """Of ordinary length, shaken later or too short, of other structures, or several of them."""

    def part(*problems: Problem):
        return part_of_record.part_of_record(JointProblem.of(*problems), Spline().build(problems[0].record))

    assert part(problem) is None
    in_parts(monkeypatch)
    for changed in (shaken_later(problem.record), problem.record.until(900)):
        assert part(replace(problem, record=changed)) is None
    assert part(replace(problem, structure=small_chain("duffing"))) is None
    assert part(problem, replace(problem)) is None


@pytest.mark.slow
def test_where_part_and_whole_have_little_in_common_all_of_it_is_searched(problem, monkeypatch):
    whole, _ = solved(problem)
    in_parts(monkeypatch)
    monkeypatch.setattr(part_of_record, "NEAR_STEPS", -1.0)
    found, _ = solved(problem)
    np.testing.assert_array_equal(found.trained.solution.point.parameters, whole.trained.solution.point.parameters)
