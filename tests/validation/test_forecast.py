"""Blocks of time: the estimator sees what lies before them alone, and a better system forecasts them better."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from interrupted_runs import without_figures
from small_estimates import parameter_estimate
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.training.base import TrainedNetwork, Training
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.validation.base import Setup
from pinn_cli.validation.forecast import Forecast

ONE = (
    "system.ndof=3", "scheme.unobserved_fraction=0.67", "simulation.duration=24", "simulation.samples=512",
    "excitation.band=[0.2,0.8]", "noise.snr_db=30", "threads=1",
)  # fmt: skip


class Guess(Training):
    """Knows the true response as far as it sees the record, and every stiffness but for a factor."""

    def __init__(self, factor: float = 1.0) -> None:
        self.factor, self.seen = factor, list[Record]()

    def solve(self, problem: JointProblem, design: object, run: RunContext) -> Estimate:
        record = problem.alone.record
        self.seen.append(record)
        truth = measured(small_chain()).truth.response
        samples = len(record.time)
        known = Response(record.time, **{q: getattr(truth, q)[:samples] for q in QUANTITIES})
        found = [parameter_estimate(f"k_{dof}", 15.0, 15.0 * self.factor, 0.1, 14.0, 16.0) for dof in (1, 2, 3)]
        return Estimate(known, Response.unknown(known.time, 3), found, pd.DataFrame(), {})


@pytest.fixture(scope="module")
def problem() -> JointProblem:
    return SparseRecovery().pose(small_chain(), [accelerations(measured(small_chain(), snr_db=30.0).record, (2,))])


def estimator(training: Training) -> Setup:
    return Setup(small_chain(), SparseRecovery(), TrainedNetwork(training, Spline()), RunContext())


def test_the_estimator_sees_what_lies_before_a_block_alone(problem: JointProblem) -> None:
    guess = Guess()
    score = Forecast(2, 0.25).score(problem, None, estimator(guess))
    assert [len(seen.time) for seen in guess.seen] == [129, 193]  # of 257
    for seen in guess.seen:
        np.testing.assert_array_equal(seen.acceleration, problem.alone.record.acceleration[: len(seen.time)])
    assert score.table["samples"].tolist() == [64, 64, 128]
    assert score.table["dof"].tolist() == [2, 2, "all"]
    assert score.table["withheld_from"].tolist()[:2] == problem.alone.record.time[[129, 193]].tolist()


def test_the_score_orders_systems(problem: JointProblem) -> None:
    scores = [Forecast().score(problem, None, estimator(Guess(factor))).value for factor in (1.0, 1.02, 1.1, 2.0)]
    assert scores == sorted(scores)
    assert scores[0] < 0.7  # the measured force drives the forecast, with its noise


def test_what_cannot_be_scored_is_refused(problem: JointProblem) -> None:
    for blocks, share in ((3, 0.01), (3, 0.33), (6, 0.2)):
        with pytest.raises(InputError, match=rf"validation\.share={share}: must be 16 samples or more"):
            Forecast(blocks, share).check(problem, estimator(Guess()))
    force = problem.alone.record.force.copy()
    force[:, 0] = np.nan
    own = problem.alone
    blind = JointProblem.of(replace(own, record=replace(own.record, force=force)))
    with pytest.raises(InputError, match="that on DOF 1 is neither measured nor known to be zero"):
        Forecast().check(blind, estimator(Guess()))
    for share in (0, 1, "half"):
        with pytest.raises(InputError, match=r"validation\.share"):
            Forecast(3, share)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"validation\.blocks"):
        Forecast(0)


def test_a_forecast_that_fails_leaves_no_score(problem: JointProblem) -> None:
    class Diverges(Guess):
        def solve(self, problem: JointProblem, design: object, run: RunContext) -> Estimate:
            raise DivergenceError("diverged at iteration 7")

    score = Forecast().score(problem, None, estimator(Diverges()))
    assert np.isnan(score.value)
    assert score.reason == "with the record up to 4.875 s: diverged at iteration 7"
    unstable = Forecast().score(problem, None, estimator(Guess(-1e6)))
    assert np.isnan(unstable.value)


def test_a_run_with_one_sensor_is_scored(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    plain, scored = pinn_run(*ONE), pinn_run(*ONE, "validation=forecast")
    assert scored.status == 0, scored.err
    assert (plain.directory / "fitness.csv").read_bytes() == (scored.directory / "fitness.csv").read_bytes()
    kept = json.loads((scored.directory / "run.json").read_text())["validation"]
    assert kept["name"] == "forecast"
    assert 0.0 <= kept["score"] < 1.0
    assert f"validation score (forecast; log of error over noise, 0 at best): {kept['score']:.5g}" in scored.out
    assert pinn_run(*ONE, "validation=heldout").err.endswith("validation=forecast withholds blocks of time\n")
