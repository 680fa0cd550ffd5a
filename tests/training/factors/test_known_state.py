"""A motion that is known to begin at rest, and a prior of one's own: what they add to every estimator."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from one_record import by_spline, evidence_of, levels_of, shown_noise
from small_problems import accelerations, measured, small_chain

from pinn_cli.baseline.kalman_smoother import KalmanSmoother
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Measurements, Record
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import RESIDUAL_MOTION, Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.factors.factor import Factor
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.gradient.losses import LearnedParameters, Losses
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.row_sums import RowSums

SENSORS = (1, 2, 3, 4)


@cache
def long_chain() -> Measurements:
    return measured(small_chain(ndof=12), snr_db=20.0, duration=40.0, samples=513)


def posed(record: Record, begins: str, ndof: int = 12) -> Problem:
    return SparseRecovery(initial_motion=begins).pose(small_chain(ndof=ndof), [record]).alone


def solved(estimator: str, problem: Problem) -> Estimate:
    if estimator == "kalman_smoother":
        found = KalmanSmoother().solve(JointProblem.of(problem), RunContext())
        assert found is not None
        return found
    return by_spline(problem)


def fitness_of_the_far(estimate: Estimate, truth: Response) -> float:
    far = slice(len(SENSORS), None)
    error = np.linalg.norm((estimate.response.displacement - truth.displacement)[:, far], axis=0)
    return float(100.0 * (1.0 - error / np.linalg.norm(truth.displacement[:, far], axis=0)).mean())


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["gauss_newton", "kalman_smoother"])
def test_knowing_rest_makes_the_far_end_of_a_long_chain_known(estimator):
    measurements = long_chain()
    record, truth = accelerations(measurements.record, SENSORS), measurements.truth.response
    free, rest = (solved(estimator, posed(record, begins)) for begins in ("free", "rest"))
    assert fitness_of_the_far(free, truth) < 90.0
    assert fitness_of_the_far(rest, truth) > 95.0
    held = np.abs(rest.response.displacement - truth.displacement) < 1.96 * rest.std.displacement
    assert held.mean() > 0.9
    assert rest.std.displacement[:, -1].mean() < 0.5 * free.std.displacement[:, -1].mean()


@pytest.mark.slow
def test_a_record_that_begins_in_motion_is_estimated_freely():
    measurements = long_chain()
    later = slice(200, None)
    record, truth = accelerations(measurements.record, SENSORS), measurements.truth.response
    record = replace(record, time=record.time[later], **{q: getattr(record, q)[later] for q in QUANTITIES})
    free, rest = (solved("gauss_newton", posed(record, begins)) for begins in ("free", "rest"))
    near = [np.linalg.norm((e.response.velocity - truth.velocity[later])[:, :4]) for e in (free, rest)]
    assert near[0] < 0.1 * np.linalg.norm(truth.velocity[later, :4])
    assert near[1] > 2.0 * near[0]


@pytest.mark.parametrize(
    "design", [Spline(intervals=12), Spline(intervals=12, continuity="penalised"), Fourier(harmonics=5)]
)
def test_the_loss_is_that_of_the_first_state(design):
    record = accelerations(measured(small_chain(), snr_db=20.0).record)
    network, problem = design.build(record), posed(record, "rest", ndof=3)
    equations, noise = NormalEquations(network, problem), shown_noise(record, 0.1, 0.1)
    point, generator = equations.start(), torch.Generator().manual_seed(0)
    point = Point(0.1 * torch.randn(len(point.unknowns), generator=generator).double(), point.parameters)
    states = equations.flat_states(equations.observation, point)
    first = np.stack((states.displacement[0], states.velocity[0]), axis=1)
    expected = np.sum((first / problem.initial_deviation) ** 2)
    assert equations.losses(point, noise)["initial"] == pytest.approx(expected, rel=1e-10)


def test_a_multilayer_perceptron_begins_where_it_is_told():
    record = accelerations(measured(small_chain(), snr_db=20.0).record)
    problem = posed(record, "rest", ndof=3)
    design = Mlp(1, 32, "sine", embedding="fourier")
    estimate = GaussNewton(iterations=4).solve(JointProblem.of(problem), design, RunContext())
    deviation = problem.initial_deviation
    assert deviation is not None
    for motion, known in zip(("displacement", "velocity"), deviation, strict=True):
        assert np.abs(getattr(estimate.response, motion)[0]).max() < 10.0 * known
        assert getattr(estimate.std, motion)[0].max() < 1.1 * known


def test_a_gradient_training_has_it_among_its_priors():
    record = accelerations(measured(small_chain()).record)
    terms = []
    for begins in ("free", "rest"):
        problem = posed(record, begins, ndof=3)
        network = Mlp(activation="tanh").build(record, torch.float64)
        network.reset(0)
        losses = Losses(problem, None, "cpu", torch.float64)
        terms.append(losses.terms(network, LearnedParameters(problem, torch.float64))["prior"].item())
    states = network(torch.as_tensor(record.time[:1]))
    u, v = problem.initial_deviation or (0.0, 0.0)
    expected = float((states.displacement / u).square().sum() + (states.velocity / v).square().sum())
    assert terms[1] - terms[0] == pytest.approx(expected / len(record.time))
    assert expected > 0


@pytest.mark.parametrize("scheme", [SparseRecovery, StateParameter, Bayesian])
def test_every_scheme_says_how_the_motion_begins(scheme):
    record = measured(small_chain()).record
    assert scheme().initial_motion == "free"
    posing = scheme(initial_motion="rest", **({"unknown": "k_1"} if scheme is StateParameter else {}))
    problem = posing.pose(small_chain(), [record]).alone
    deviation = problem.initial_deviation
    largest = np.sqrt(np.mean(record.displacement**2, axis=0)).max()
    assert deviation[0] == pytest.approx(RESIDUAL_MOTION * largest, rel=1e-6)
    with pytest.raises(InputError, match=r"scheme\.initial_motion=quiet: must be one of free, rest"):
        scheme(initial_motion="quiet")


class Still(Factor):
    """The readout is small: each weight to a standard deviation."""

    name = "still"

    def __init__(self, frame: NormalEquations, deviation: float) -> None:
        super().__init__(frame)
        self.weight = deviation**-2

    def loss(self, point: Point, noise: NoiseModel) -> float:
        return self.weight * float(point.unknowns.square().sum())

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        sums.add_diagonal(self.weight, point.unknowns.cpu().numpy())


@pytest.mark.parametrize("deviation", [1e3, 1e-6])
def test_it_counts_like_all_others(deviation: float) -> None:
    record = measured(small_chain("linear"), snr_db=40.0, duration=6.0).record
    problem = Problem(small_chain("linear"), record)
    plain, believed = (NormalEquations(Spline().build(record), problem) for _ in range(2))
    believed.factors.append(Still(believed, deviation))
    noise = levels_of(shown_noise(record, 0.01))
    size = {}
    for own in (plain, believed):
        trained = evidence_of(own).train(noise, own.start())
        assert trained.solution.converged
        size[own] = float(np.abs(trained.solution.point.unknowns).max())
    lost = believed.losses(trained.solution.point, noise.records[0])["still"]
    assert lost == pytest.approx(deviation**-2 * float(trained.solution.point.unknowns.square().sum()))
    assert (
        size[believed] == pytest.approx(size[plain], rel=1e-3)
        if deviation > 1.0
        else size[believed] < 0.1 * size[plain]
    )
