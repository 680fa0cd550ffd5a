"""Sensors and blocks of time that the estimator never sees, and the score of a predicted channel."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from interrupted_runs import without_figures
from small_estimates import parameter_estimate
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Measurements, Truth
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.simulated import Simulated
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import TrainedNetwork, Training
from pinn_cli.validation.evidence import EvidenceScore
from pinn_cli.validation.forecast import Forecast
from pinn_cli.validation.heldout import HeldOut
from pinn_cli.validation.validation import Setup, channel_noise, compared

SHORT = ("excitation.band=[0.2,0.8]", "threads=1")
# Two sensors, so that one can be spared, and a single one.
TWO = (
    *SHORT, "system.ndof=4", "scheme.unobserved_fraction=0.5", "simulation.duration=12", "simulation.samples=256",
    "noise.snr_db=20",
)  # fmt: skip
ONE = (
    *SHORT, "system.ndof=3", "scheme.unobserved_fraction=0.67", "simulation.duration=24", "simulation.samples=512",
    "noise.snr_db=30",
)  # fmt: skip


class Guess(Training):
    """Notes what it is given; knows the true response as far as that goes, and every stiffness, but for factors."""

    def __init__(self, acceleration: float = 1.0, stiffness: float = 1.0) -> None:
        self.acceleration, self.stiffness, self.seen = acceleration, stiffness, list[Problem]()

    def solve(self, problem: JointProblem, design: object, run: RunContext) -> Estimate:
        self.seen.append(problem.alone)
        truth, time = measured(small_chain()).truth.response, problem.alone.record.time
        known = {quantity: getattr(truth, quantity)[: len(time)] for quantity in QUANTITIES}
        std = Response(time, **{quantity: np.full_like(values, 1e-3) for quantity, values in known.items()})
        known["acceleration"] = self.acceleration * known["acceleration"]
        k = [parameter_estimate(f"k_{dof}", 15.0, 15.0 * self.stiffness, 0.1, 14.0, 16.0) for dof in (1, 2, 3)]
        return Estimate(Response(time, **known), std, k, pd.DataFrame(), {})


class Diverges(Guess):
    def solve(self, problem: JointProblem, design: object, run: RunContext) -> Estimate:
        raise DivergenceError("diverged at iteration 7")


def posed(*dofs: int, snr_db: float = 20.0, scheme=None) -> JointProblem:
    record = accelerations(measured(small_chain(), snr_db=snr_db).record, dofs)
    return (scheme or SparseRecovery()).pose(small_chain(), [record])


@pytest.fixture(scope="module")
def two() -> JointProblem:
    return posed(1, 3)


@pytest.fixture(scope="module")
def one() -> JointProblem:
    return posed(2, snr_db=30.0)


def estimator(training: Training, scheme=None) -> Setup:
    return Setup(small_chain(), scheme or SparseRecovery(), TrainedNetwork(training, Spline()), RunContext())


def test_each_observed_dof_is_withheld_once(two: JointProblem) -> None:
    guess = Guess()
    HeldOut().score(two, None, estimator(guess))
    assert [np.flatnonzero(p.record.observed).tolist() for p in guess.seen] == [[2], [0]]
    for seen in guess.seen:
        assert np.isnan(seen.record.acceleration[:, ~seen.record.observed]).all()
        np.testing.assert_array_equal(seen.record.force, two.alone.record.force)
    score = HeldOut([3]).score(two, None, estimator(Guess()))
    assert score.table["withheld_dof"].tolist() == [3, "all"]
    assert score.table["score"].iloc[-1] == score.value


def test_a_strain_of_other_dofs_stays(two: JointProblem) -> None:
    """Of displacements that no sensor shows by themselves."""
    record = two.alone.record
    strain = Channel("eps", "displacement", {1: 1.0, 2: -1.0}, record.time, record.acceleration[:, 0])
    strained = JointProblem.of(replace(two.alone, record=replace(record, calibrated=(strain,))))
    seen = [HeldOut().without(dof, strained, estimator(Guess())).alone.record for dof in (1, 3)]
    assert [[channel.key for channel in record.calibrated] for record in seen] == [["eps"], []]


def test_the_estimator_sees_what_lies_before_a_block_alone(one: JointProblem) -> None:
    guess = Guess()
    score = Forecast(2, 0.25).score(one, None, estimator(guess))
    assert [len(seen.record.time) for seen in guess.seen] == [129, 193]  # of 257
    for seen in guess.seen:
        own = seen.record.acceleration
        np.testing.assert_array_equal(own, one.alone.record.acceleration[: len(own)])
    assert score.table["samples"].tolist() == [64, 64, 128]
    assert score.table["dof"].tolist() == [2, 2, "all"]
    assert score.table["withheld_from"].tolist()[:2] == one.alone.record.time[[129, 193]].tolist()


def test_scores_order_predictions(one: JointProblem, two: JointProblem) -> None:
    predicted = [HeldOut().score(two, None, estimator(Guess(f))).value for f in (1.0, 0.95, 0.8, 0.0)]
    assert predicted == sorted(predicted)
    assert predicted[0] == pytest.approx(0.0, abs=0.05)
    forecast = [Forecast().score(one, None, estimator(Guess(stiffness=f))).value for f in (1.0, 1.02, 1.1, 2.0)]
    assert forecast == sorted(forecast)
    assert forecast[0] < 0.7  # the measured force drives the forecast, with its noise


def test_what_is_unknown_stays_unknown_and_nothing_else_becomes_it() -> None:
    scheme, guess = StateParameter(unobserved=None), Guess()
    problem = posed(1, 3, scheme=scheme)
    HeldOut().score(problem, None, estimator(guess, scheme))
    unknown = {p.name for p in problem.alone.uncertain if p.unknown}
    assert unknown == {"k_2", "kappa_2"}
    assert all({p.name for p in seen.uncertain if p.unknown} == unknown for seen in guess.seen)


def test_what_fails_leaves_no_score(one: JointProblem, two: JointProblem) -> None:
    for validation, problem, part in (
        (HeldOut(), two, "without the sensors of DOF 1"),
        (Forecast(), one, "with the record up to 4.875 s"),
    ):
        score = validation.score(problem, None, estimator(Diverges()))
        assert np.isnan(score.value)
        assert score.reason == f"{part}: diverged at iteration 7"
    assert np.isnan(Forecast().score(one, None, estimator(Guess(stiffness=-1e6))).value)  # unstable


def test_what_cannot_be_scored_is_refused(one: JointProblem, two: JointProblem) -> None:
    own, setup = one.alone, estimator(Guess())
    force = own.record.force.copy()
    force[:, 0] = np.nan
    blind = JointProblem.of(replace(own, record=replace(own.record, force=force)))
    for validation, problem, told in (
        (HeldOut(), one, "two DOFs or more"),
        (HeldOut([2]), two, "observed DOFs: 1, 3"),
        (EvidenceScore(), two, "gauss_newton"),
        (Forecast(), blind, "the force on DOF 1 is neither measured nor known to be zero"),
        *(
            (Forecast(n, s), one, rf"share={s}: must be 16 samples or more")
            for n, s in ((3, 0.01), (3, 0.33), (6, 0.2))
        ),
    ):
        with pytest.raises(InputError, match=told):
            validation.check(problem, setup)


def test_a_run_is_scored_and_its_estimate_stays_as_it_is(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    plain, scored = pinn_run(*TWO), pinn_run(*TWO, "validation=heldout").done()
    for name in ("fitness.csv", "parameters.csv", "free_run.csv"):
        assert (plain.directory / name).read_bytes() == (scored.directory / name).read_bytes()
    kept = scored.record["validation"]
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


@pytest.mark.slow
def test_a_run_with_one_sensor_is_scored(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    scored = pinn_run(*ONE, "validation=forecast").done()
    kept = scored.record["validation"]
    assert kept["name"] == "forecast"
    assert 0.0 <= kept["score"] < 1.0
    assert f"validation score (forecast; log of error over noise, 0 at best): {kept['score']:.5g}" in scored.out
    assert pinn_run(*ONE, "validation=heldout").err.endswith("validation=forecast withholds blocks of time\n")


@pytest.mark.slow
def test_the_evidence_prefers_the_right_model(pinn_run: PinnRun, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    scores = {}
    for error in ("none", "linear"):
        outcome = pinn_run(*TWO, "validation=evidence", f"model_error={error}", "excitation.rms=3", "noise.snr_db=40")
        scores[error] = outcome.record["validation"]["score"]
    assert scores["none"] < scores["linear"]


NOISE, SAMPLES = 0.1, 200_000


def test_the_truth_scores_nothing_and_the_right_spread_best() -> None:
    response = np.random.default_rng(0).normal(size=SAMPLES)
    shown = response + NOISE * np.random.default_rng(1).normal(size=SAMPLES)
    agreement = compared(shown, response, np.zeros(SAMPLES), NOISE)
    assert agreement["score"] == pytest.approx(0.0, abs=0.01)
    assert agreement["standardised_error_rms"] == pytest.approx(1.0, abs=0.01)
    assert agreement["coverage_95_percent"] == pytest.approx(95.0, abs=0.5)
    predicted = response + 0.3 * np.random.default_rng(2).normal(size=SAMPLES)
    spreads = [0.05, 0.15, 0.3, 0.6, 1.2]
    scores = [compared(shown, predicted, np.full(SAMPLES, spread), NOISE)["score"] for spread in spreads]
    assert spreads[int(np.argmin(scores))] == 0.3
    # Of a normal distribution: half the logarithm of the variances' ratio.
    assert min(scores) == pytest.approx(0.5 * np.log(0.1 / 0.01), rel=0.01)
    agreement = compared(shown, predicted, np.full(SAMPLES, np.nan), NOISE)
    assert agreement["score"] == pytest.approx(np.log(agreement["error_rms"] / NOISE))
    assert np.isnan(agreement["coverage_95_percent"])
    assert np.isnan(compared(shown, np.full(SAMPLES, np.nan), np.zeros(SAMPLES), NOISE)["score"])


def test_the_noise_is_that_of_the_channel() -> None:
    structure = small_chain()
    noisy, clean = (measured(structure, snr_db=snr).record for snr in (20.0, None))
    for dof in np.flatnonzero(noisy.sensors("acceleration")):
        true = float(np.std(noisy.acceleration[:, dof] - clean.acceleration[:, dof]))
        of_noisy, of_clean = (record.column("acceleration", int(dof)) for record in (noisy, clean))
        assert channel_noise(noisy, of_noisy) == pytest.approx(true, rel=0.3)
        rms = float(np.sqrt(np.mean(clean.acceleration[:, dof] ** 2)))
        assert 1e-6 * rms <= channel_noise(clean, of_clean) < 0.01 * rms
