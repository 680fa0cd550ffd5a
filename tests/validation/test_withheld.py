"""Withheld sensors: the estimator never sees them, the score is made of measurements alone, and all else stays."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from interrupted_runs import without_figures
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Measurements, Record, Truth
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.simulated import Simulated
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.system.structure import Structure
from pinn_cli.training.base import TrainedNetwork, Training
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.validation.base import Setup
from pinn_cli.validation.evidence import EvidenceScore
from pinn_cli.validation.heldout import HeldOut

# Two sensors, so that one can be spared.
TWO = (
    "system.ndof=4", "scheme.unobserved_fraction=0.5", "simulation.duration=12", "simulation.samples=256",
    "excitation.band=[0.2,0.8]", "noise.snr_db=20", "threads=1",
)  # fmt: skip


class Guess(Training):
    """An estimator that notes what it is given and predicts a multiple of a known response."""

    def __init__(self, response: Response, factor: float = 1.0) -> None:
        self.response, self.factor, self.seen = response, factor, list[Problem]()

    def solve(self, problem: JointProblem, design: object, run: RunContext) -> Estimate:
        self.seen.append(problem.alone)
        found = replace(self.response, acceleration=self.factor * self.response.acceleration)
        std = replace(self.response, **{q: np.full_like(self.response.acceleration, 1e-3) for q in QUANTITIES})
        return Estimate(found, std, [], pd.DataFrame(), {})


@pytest.fixture(scope="module")
def record() -> Record:
    return accelerations(measured(small_chain(), snr_db=20.0).record, (1, 3))


def estimator(training: Training, scheme=None) -> Setup:
    return Setup(small_chain(), scheme or SparseRecovery(), TrainedNetwork(training, Spline()), RunContext())


def response_of() -> Response:
    return measured(small_chain()).truth.response


def test_each_observed_dof_is_withheld_once(record: Record) -> None:
    guess = Guess(response_of())
    problem = SparseRecovery().pose(small_chain(), [record])
    HeldOut().score(problem, None, estimator(guess))
    assert [np.flatnonzero(p.record.observed).tolist() for p in guess.seen] == [[2], [0]]
    for seen in guess.seen:
        assert np.isnan(seen.record.acceleration[:, ~seen.record.observed]).all()
        np.testing.assert_array_equal(seen.record.force, record.force)


def test_the_score_orders_predictions(record: Record) -> None:
    problem = SparseRecovery().pose(small_chain(), [record])
    factors = (1.0, 0.95, 0.8, 0.0)
    scores = [HeldOut().score(problem, None, estimator(Guess(response_of(), f))).value for f in factors]
    assert scores == sorted(scores)
    assert scores[0] == pytest.approx(0.0, abs=0.05)


def test_chosen_dofs_and_the_table(record: Record) -> None:
    problem = SparseRecovery().pose(small_chain(), [record])
    score = HeldOut([3]).score(problem, None, estimator(Guess(response_of())))
    assert score.table["withheld_dof"].tolist() == [3, "all"]
    assert score.table["score"].iloc[-1] == score.value


def test_what_is_unknown_stays_unknown_and_nothing_else_becomes_it(record: Record) -> None:
    scheme = StateParameter(unobserved=None)
    problem = scheme.pose(small_chain(), [record])
    guess = Guess(response_of())
    HeldOut().score(problem, None, estimator(guess, scheme))
    unknown = {p.name for p in problem.alone.uncertain if p.unknown}
    assert unknown == {"k_2", "kappa_2"}
    assert all({p.name for p in seen.uncertain if p.unknown} == unknown for seen in guess.seen)


def test_a_fold_that_diverges_leaves_no_score(record: Record) -> None:
    class Diverges(Guess):
        def solve(self, problem: JointProblem, design: object, run: RunContext) -> Estimate:
            raise DivergenceError("diverged at iteration 7")

    problem = SparseRecovery().pose(small_chain(), [record])
    score = HeldOut().score(problem, None, estimator(Diverges(response_of())))
    assert np.isnan(score.value)
    assert score.reason == "without the sensors of DOF 1: diverged at iteration 7"


@pytest.mark.parametrize("dofs", [[0], [], "two", [1.5]])
def test_impossible_dofs_are_named(dofs: object) -> None:
    with pytest.raises(InputError, match=r"validation\.dofs"):
        HeldOut(dofs)


def test_what_cannot_be_scored_is_refused(record: Record) -> None:
    alone = SparseRecovery().pose(small_chain(), [accelerations(record, (1,))])
    with pytest.raises(InputError, match="two DOFs or more"):
        HeldOut().check(alone, estimator(Guess(response_of())))
    two = SparseRecovery().pose(small_chain(), [record])
    with pytest.raises(InputError, match="observed DOFs: 1, 3"):
        HeldOut([2]).check(two, estimator(Guess(response_of())))
    with pytest.raises(InputError, match="gauss_newton"):
        EvidenceScore().check(two, estimator(Guess(response_of())))


def test_a_run_is_scored_and_its_estimate_stays_as_it_is(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    plain, scored = pinn_run(*TWO), pinn_run(*TWO, "validation=heldout")
    assert scored.status == 0, scored.err
    for name in ("fitness.csv", "parameters.csv", "free_run.csv"):
        assert (plain.directory / name).read_bytes() == (scored.directory / name).read_bytes()
    kept = json.loads((scored.directory / "run.json").read_text())["validation"]
    table = pd.read_csv(scored.directory / "score.csv", dtype={"withheld_dof": str}).set_index("withheld_dof")
    assert kept["name"] == "heldout"
    assert table.loc["all", "score"] == pytest.approx(kept["score"])
    assert f"{kept['score']:.5g}" in scored.out
    assert not (plain.directory / "score.csv").exists()
    monkeypatch.setattr(Simulated, "measure", without_truth(Simulated.measure))
    blind = pinn_run(*TWO, "validation=heldout").directory
    assert (scored.directory / "score.csv").read_bytes() == (blind / "score.csv").read_bytes()


def without_truth(measure):
    def blind(self: Simulated, structure: Structure) -> Measurements:
        honest = measure(self, structure)
        return replace(honest, truth=Truth(Response.unknown(honest.record.time, structure.ndof)))

    return blind


def test_the_evidence_prefers_the_right_model(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    scores = {}
    for error in ("none", "linear"):
        outcome = pinn_run(*TWO, "validation=evidence", f"model_error={error}", "excitation.rms=3", "noise.snr_db=40")
        scores[error] = json.loads((outcome.directory / "run.json").read_text())["validation"]["score"]
    assert scores["none"] < scores["linear"]
