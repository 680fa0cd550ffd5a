"""The smoother as a baseline: what was put in is found, with its noise, and found again in other units of time."""

import logging
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm, truncnorm
from small_problems import QUANTITIES, accelerations, excitation, measured, relative_error, small_chain
from small_problems import sped_up as faster
from structures import hysteretic, modal

from pinn_cli.baseline import baseline_estimate
from pinn_cli.baseline.iterated_smoother import IteratedSmoother, first_pass, most_probable, widened
from pinn_cli.baseline.kalman_smoother import KalmanSmoother, _parameters
from pinn_cli.baseline.state_space import NoiseLevels, StateSpace
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, RunContext


def solved(problem: Problem, **settings) -> Estimate:
    return KalmanSmoother(**settings).solve(JointProblem.of(problem), RunContext())


def covered(estimate: Estimate, truth: Response, quantity: str) -> float:
    """Share of points whose 95 % band covers the truth."""
    error = np.abs(getattr(estimate.response, quantity) - getattr(truth, quantity))
    return float((error <= 1.96 * getattr(estimate.std, quantity)).mean())


@pytest.mark.parametrize(
    ("nonlinearity", "hold", "snr_db", "tolerances"),
    [
        ("linear", "zero_order", 40.0, (0.06, 0.03, 0.03)),
        ("duffing", "exact", 40.0, (0.06, 0.03, 0.03)),
        ("van_der_pol", "zero_order", 40.0, (0.06, 0.03, 0.03)),
        ("power_damping", "exact", 40.0, (0.06, 0.03, 0.03)),
        ("duffing", "zero_order", None, (1e-4, 1e-4, 1e-4)),
    ],
)
def test_motion_where_there_is_no_sensor(nonlinearity: str, hold: str, snr_db: float | None, tolerances) -> None:
    structure = small_chain(nonlinearity)
    measurements = measured(structure, hold, snr_db=snr_db, duration=24.0, samples=513)
    estimate = solved(Problem(structure, accelerations(measurements.record)))
    truth = measurements.truth.response
    for quantity, tolerance in zip(QUANTITIES, tolerances, strict=True):
        assert relative_error(getattr(estimate.response, quantity), getattr(truth, quantity)) < tolerance
    assert estimate.summary["stop_reason"] == "converged"
    assert list(estimate.history["iteration"]) == list(range(1, estimate.summary["iterations"] + 1))


@pytest.mark.slow
def test_parameters_that_are_wrong_are_put_right_with_honest_intervals() -> None:
    true = small_chain("duffing")
    measurements = measured(true, snr_db=40.0, duration=48.0, samples=1025)
    offs = {"c": 1.05, "k": 0.95, "kappa": 1.06}
    wrong = true.with_parameters(**{name: true.parameters[name] * factor for name, factor in offs.items()})
    record = accelerations(measurements.record)
    problem = SparseRecovery(parameter_uncertainty=0.075).pose(wrong, [record]).alone
    estimate = solved(problem)
    by_name = {p.name: p for p in estimate.parameters}
    assert list(by_name) == [p.name for p in problem.uncertain]
    assert all(by_name[f"k_{i}"].estimate == pytest.approx(15.0, rel=0.01) for i in (1, 2, 3))
    truths = np.array([float(true.parameters[p.kind][p.index]) for p in problem.uncertain])
    scores = [(p.estimate - value) / p.std for p, value in zip(estimate.parameters, truths, strict=True)]
    assert np.sqrt(np.mean(np.square(scores))) < 2.0
    assert all(p.lower_90 < p.estimate < p.upper_90 for p in estimate.parameters)
    held = solved(replace(problem, uncertain=()))
    truth = measurements.truth.response.displacement
    freed, fixed = (relative_error(e.response.displacement, truth) for e in (estimate, held))
    assert freed < fixed / 2.0
    assert held.parameters == []


@pytest.mark.slow
def test_bands_cover_the_truth() -> None:
    shares = {quantity: [] for quantity in QUANTITIES}
    for seed in range(8):
        structure = small_chain("duffing")
        force = BandedNoise(3, 24.0, 513, [0.1, 1.0], 1.0, [1], seed=seed)
        simulation = Simulation(24.0, 513)
        truth = simulation.run(structure, force.force)
        rng = np.random.default_rng(seed)
        noisy = [getattr(truth, q) + 0.05 * getattr(truth, q).std() * rng.normal(size=(513, 3)) for q in QUANTITIES]
        load = truth.force + np.array([0.05, 0.0, 0.0]) * rng.normal(size=(513, 3))
        record = accelerations(Record(simulation.time, *noisy, load, np.arange(3) > 0))
        estimate = solved(Problem(structure, record))
        for quantity, share in shares.items():
            share.append(covered(estimate, truth, quantity))
    assert all(np.mean(share) > 0.85 for share in shares.values()), shares


@pytest.mark.slow
def test_a_force_that_nobody_measures_is_found() -> None:
    structure = small_chain("duffing")
    measurements = measured(structure, snr_db=40.0, duration=24.0, samples=513)
    force = measurements.record.force.copy()
    force[:, 0] = np.nan
    sensors = {"acceleration": (1, 2, 3), "displacement": (1,)}
    record = replace(measurements.record, force=force).keep(sensors)
    estimate = solved(Problem(structure, record))
    truth = measurements.truth.response
    assert relative_error(estimate.response.force[:, 0], truth.force[:, 0]) < 0.1
    assert covered(estimate, truth, "force") > 0.85
    assert relative_error(estimate.response.displacement, truth.displacement) < 0.02


@pytest.mark.parametrize("structure", [hysteretic(), modal()], ids=["hysteretic", "modal"])
def test_hidden_forces_and_modes(structure: Structure) -> None:
    measurements = measured(structure, snr_db=40.0, duration=12.0, samples=601)
    scheme = SparseRecovery(unobserved=[structure.ndof])
    problem = scheme.pose(structure, [scheme.observe(measurements.record)]).alone
    KalmanSmoother().check(problem)
    estimate, truth = solved(problem), measurements.truth.response
    for quantity in ("velocity", "acceleration"):
        assert relative_error(getattr(estimate.response, quantity), getattr(truth, quantity)) < 0.01
        assert covered(estimate, truth, quantity) > 0.9


def test_the_noise_of_every_sensor_is_found() -> None:
    measurements = measured(small_chain("duffing"), snr_db=20.0, duration=24.0, samples=513)
    space = StateSpace(Problem(small_chain("duffing"), accelerations(measurements.record)))
    levels = most_probable(IteratedSmoother(space, passes=12, learn_spread=True), space.first_levels()).levels
    ratio, truth = 0.1, measurements.truth.response
    np.testing.assert_allclose(levels.sensors, ratio * truth.acceleration[:, :2].std(axis=0), rtol=0.1)
    np.testing.assert_allclose(levels.forces[1], ratio * truth.force[:, 0].std(), rtol=0.1)


def test_a_structure_thirty_times_faster_gives_the_same_and_a_given_process_noise_is_kept() -> None:
    speed = 30.0
    record = accelerations(measured(small_chain("duffing"), snr_db=30.0).record)
    slow = solved(Problem(small_chain("duffing"), record), learn_spread=False)
    fast = solved(Problem(small_chain("duffing", speed=speed), faster(record, speed)), learn_spread=False)
    for order, quantity in enumerate(QUANTITIES):
        expected = getattr(slow.response, quantity) * speed**order
        assert relative_error(getattr(fast.response, quantity), expected) < 1e-6
    assert solved(Problem(small_chain(), record), process_noise=0.01).noise.discrepancy == pytest.approx(0.01)


def test_a_load_cell_shares_what_the_motion_needs_with_the_model() -> None:
    record = accelerations(measured(small_chain()).record)
    space = StateSpace(Problem(small_chain(), record))
    levels = NoiseLevels(np.ones(2), np.array([4.0, 3.0]))
    model = space.model(space.linearise(space.start()), levels)
    np.testing.assert_allclose(model.disturbance_variance, [25.0, 16.0, 16.0])


@pytest.mark.slow
def test_every_parameter_may_be_unknown() -> None:
    """On the way from the record's own scale to the truth, damping turns negative: the smoother must get through."""
    true = small_chain("duffing")
    record = measured(true, snr_db=30.0, duration=120.0, samples=2049).record
    problem = Bayesian().pose(true, [Bayesian().observe(record)]).alone
    estimate = solved(problem)
    for parameter in estimate.parameters:
        truth = float(true.parameters[parameter.name.partition("_")[0]][int(parameter.name[-1]) - 1])
        assert abs(parameter.estimate - truth) < 4.0 * parameter.std
        assert parameter.std < 0.1 * truth
    assert estimate.summary["stop_reason"] == "converged"


def test_a_smoother_that_breaks_says_so_and_gives_no_estimate(monkeypatch, caplog):
    def broken(self: StateSpace, trajectory: object) -> np.ndarray:
        raise FloatingPointError("overflow at sample 3")

    monkeypatch.setattr(StateSpace, "linearise", broken)
    problem = Problem(small_chain(), accelerations(measured(small_chain()).record))
    with caplog.at_level(logging.WARNING):
        assert baseline_estimate(KalmanSmoother(), JointProblem.of(problem), RunContext()) is None
    assert "overflow at sample 3" in caplog.text


def test_a_stiffness_below_zero_becomes_what_is_left_above() -> None:
    """Gaussians that peak at these distances from what was believed, independent, of one prior deviation."""
    uncertain = (
        Parameter("k", 0, 10.0, 20.0, unknown=True, positive=True), Parameter("kappa", 0, 5.0, 3.0, unknown=True),
    )  # fmt: skip
    regression = SimpleNamespace(covariance=np.diag([1.0, 1.0, 7.0]))
    last = SimpleNamespace(trajectory=SimpleNamespace(parameters=np.array([-1.0, 0.0])), regression=regression)
    k, kappa = _parameters(SimpleNamespace(problem=SimpleNamespace(uncertain=uncertain)), last)
    expected = truncnorm(0.5, np.inf, -10.0, 20.0)
    assert k.held
    assert (k.estimate, k.std) == pytest.approx((expected.mean(), expected.std()))
    assert (k.lower_90, k.upper_90) == pytest.approx(tuple(expected.ppf([0.05, 0.95])))
    assert (kappa.estimate, kappa.held) == (5.0, False)
    assert (kappa.lower_90, kappa.upper_90) == pytest.approx(tuple(norm.ppf([0.05, 0.95], 5.0, 3.0)))


DURATION, SAMPLES, FINE = 24.0, 513, 0.001


def disturbed(unknown: np.ndarray, nonlinearity: str = "duffing") -> tuple[IteratedSmoother, NoiseLevels, Response]:
    """A chain under a known held force and an unknown one (N, n), all accelerations seen with little noise."""
    structure, simulation = small_chain(nonlinearity), Simulation(DURATION, SAMPLES, "zero_order")
    known, time = excitation(structure, DURATION, SAMPLES).force(simulation.time), simulation.time
    truth = simulation.run(structure, lambda t: (known + unknown)[np.searchsorted(time, t)])
    rng = np.random.default_rng(2)
    noisy = [getattr(truth, q) + FINE * rng.normal(size=known.shape) for q in QUANTITIES]
    record = Record(time, *noisy, known, np.arange(3) > 0, "zero_order_hold").keep({"acceleration": (1, 2, 3)})
    space = StateSpace(Problem(structure, record))
    return IteratedSmoother(space, passes=12, learn_spread=True), space.first_levels(), truth


def white(level: float, seed: int = 1) -> np.ndarray:
    return level * np.random.default_rng(seed).normal(size=(SAMPLES, 3))


@pytest.mark.parametrize(("level", "nonlinearity"), [(0.02, "linear"), (0.2, "duffing"), (0.0, "duffing")])
def test_the_process_noise_that_was_put_in_is_found(level: float, nonlinearity: str) -> None:
    smoother, levels, truth = disturbed(white(level), nonlinearity)
    best = most_probable(smoother, levels)
    as_sensor_noise = FINE * 10.0  # N, on a mass of 10 kg: a right model needs none
    assert best.levels.discrepancy == pytest.approx(level, rel=0.1, abs=0.2 * as_sensor_noise if level == 0.0 else 0.0)
    assert relative_error(best.trajectory.states[:, :3], truth.displacement) < 0.1


def test_a_coloured_model_error_is_widened_and_a_white_one_is_not() -> None:
    band = BandedNoise(3, DURATION, SAMPLES, [0.1, 1.0], 0.1, [1, 2, 3], seed=4)
    coloured = band.force(np.linspace(0.0, DURATION, SAMPLES))
    ratios = []
    for unknown in (coloured, white(0.1)):
        smoother, levels, _ = disturbed(unknown)
        best = most_probable(smoother, levels)
        ratios.append(widened(smoother, best).levels.discrepancy / best.levels.discrepancy)
    # 0.9 Hz of 10.7 Hz: a twelfth of the values.
    assert ratios[0] == pytest.approx(12.0**0.5, rel=0.3)
    assert ratios[1] < 1.25


def test_passes_settle_quadratically() -> None:
    smoother, levels, _ = disturbed(white(0.05))
    settled = smoother.settle(first_pass(smoother, levels).trajectory, levels, 1e-9)
    assert settled.step < 1e-9
    assert len(smoother.history) < 10
