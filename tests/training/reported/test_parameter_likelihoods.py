"""From a trained network to likelihoods: against sums over residuals, and against dense algebra of linear chains."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bayesian_problems import Example, posed, solved, source
from dense_model import DenseModel
from one_record import by_spline
from small_problems import NONLINEARITIES, measured, small_chain

from pinn_cli.physics import physics_residual
from pinn_cli.record.channel import Channel, unknown_calibration
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise
from pinn_cli.record.simulation import simulate
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.training.reported.parameter_likelihoods import (
    MarginalLikelihood,
    ParameterLikelihoods,
    parameter_likelihoods,
)

# Every way in which a record's force may be told: name to settings of :func:`source`.
RECORDS = {
    "force on one DOF": {"forced": (1,)},
    "force on both, three repeats": {"forced": (1, 2), "repeats": 3},
    "held force": {"forced": (1,), "hold": "zero_order"},
}
# Each law with another record, and the linear chain with all.
EXAMPLES = [
    *(("linear", record) for record in RECORDS),
    *zip([name for name in NONLINEARITIES if name != "linear"], itertools.cycle(reversed(RECORDS)), strict=False),
]


@cache
def example(nonlinearity: str = "linear", record: str = "force on one DOF") -> Example:
    return solved(posed(small_chain(nonlinearity, ndof=2), samples=129, duration=10.0, **RECORDS[record]), 40)


@cache
def found(nonlinearity: str = "linear", record: str = "force on one DOF") -> ParameterLikelihoods:
    trained = example(nonlinearity, record)
    return parameter_likelihoods(trained.evidence, trained.trained)


def deviations(marginal: MarginalLikelihood, q: np.ndarray) -> np.ndarray:
    """Theta at coordinates q in which the likelihood is N(0, I)."""
    return marginal.peak + np.linalg.cholesky(np.linalg.inv(marginal.curvature)) @ q


def directions(size: int, length: float, count: int = 6) -> np.ndarray:
    q = np.random.default_rng(size).standard_normal((count, size))
    return length * q / np.linalg.norm(q, axis=1, keepdims=True)


@pytest.mark.parametrize(("nonlinearity", "record"), EXAMPLES)
def test_the_conditional_is_the_sum_over_all_residuals_at_the_trained_motion(nonlinearity, record):
    """-1/2 sum_r sum_t sum_i (residual / sigma)^2 - count log sigma, over repeats, samples and DOFs."""
    equations, conditional = example(nonlinearity, record).equations, found(nonlinearity, record).conditional
    problem, point = equations.problem, example(nonlinearity, record).trained.solution.point
    structure = small_chain(nonlinearity, ndof=2)
    measuring = source(structure, samples=129, duration=10.0, **RECORDS[record])
    clean = measuring.measure(structure).truth.response
    repeats = [measuring.noise.added_to(clean, r).force for r in range(measuring.noise.repeats)]
    states = equations.flat_states(equations.physics, point)
    sigma = np.nanmax(conditional.sigma_force)

    def log_likelihood(theta: np.ndarray, s: float) -> float:
        values = {kind: value.clone() for kind, value in equations.prescribed.items()}
        for parameter, value in zip(problem.uncertain, theta, strict=True):
            values[parameter.kind][parameter.index] = value
        residual = physics_residual(states, equations.target, equations.dynamics, values).numpy()
        each = np.stack([residual + equations.target.force.numpy() - force for force in repeats])
        return float(-0.5 * np.sum((each / (sigma * np.exp(s))) ** 2) - each.size * s)

    std = np.sqrt(np.diag(np.linalg.inv(conditional.curvature)))
    points = [(conditional.peak, 0.0)]
    points += [
        (conditional.peak + std * q, s)
        for q, s in zip(directions(len(std), 3.0, 4), (0.0, 0.1, -0.1, 1.0), strict=True)
    ]
    expected = np.array([log_likelihood(*at) for at in points])
    given = np.array([conditional.evaluate(*at)[0] for at in points])
    np.testing.assert_allclose(given, expected, rtol=1e-7)
    # The noise that it is scaled to is the most probable one.
    assert conditional.evaluate(conditional.peak, 0.0)[2] == pytest.approx(0.0, abs=1e-6 * conditional.count)


@pytest.mark.parametrize("record", RECORDS)
def test_the_peak_of_the_marginal_is_that_of_the_joint_density(record):
    """Of a linear chain, whose weights are integrated out exactly, all but the Hessian's determinant."""
    marginal, dense = found(record=record).marginal, DenseModel(example(record=record))
    step = 1e-3
    for q in np.eye(len(marginal.peak)) * step:
        slope = dense.marginal(deviations(marginal, q))[0] - dense.marginal(deviations(marginal, -q))[0]
        assert abs(slope / (4 * step)) < 1e-3  # of a standard deviation


@pytest.mark.parametrize("record", RECORDS)
def test_of_a_linear_chain_the_marginal_is_the_exact_one(record):
    """Within two standard deviations the odds are right to a tenth (exp 0.1), within three to a quarter.

    A parabola in theta has no cubic term, and no determinant that changes with theta: with standard deviations of 2 to
    20 % of the parameters those are worth a few hundredths.
    """
    marginal, dense = found(record=record).marginal, DenseModel(example(record=record))
    least, determinant = dense.marginal(marginal.peak)
    for length, tolerance in ((1.0, 0.05), (2.0, 0.1), (3.0, 0.25)):
        for q in directions(len(marginal.peak), length):
            there = dense.marginal(deviations(marginal, q))
            exact = -0.5 * (there[0] - least) - 0.5 * (there[1] - determinant)
            assert marginal.evaluate(deviations(marginal, q), 0.0)[0] - marginal.evaluate(marginal.peak, 0.0)[0] == (
                pytest.approx(exact, abs=tolerance)
            )


@pytest.mark.parametrize("record", RECORDS)
def test_and_so_it_is_at_other_levels_of_the_forces_noise(record):
    """With an exact treatment of the noise that no feature sees, and of the scatter of repeats.

    Given the noise, the odds of parameters are right to a tenth; the noise by itself is the Gaussian that it is
    taken for, within what 95 values let gamma be off.
    """
    marginal = found(record=record).marginal
    scales, log_odds = marginal.s_mean + marginal.s_std * np.linspace(-4.0, 4.0, 9), []
    for s in scales:
        dense, difference = DenseModel(example(record=record), s), []
        for q in directions(len(marginal.peak), 1.5, 2):
            theta = deviations(marginal, q)
            difference.append(marginal.evaluate(theta, s)[0] - dense.log_likelihood(theta, s))
        assert difference == pytest.approx([np.mean(difference)] * 2, abs=0.1)
        log_odds.append(-0.5 * ((s - marginal.s_mean) / marginal.s_std) ** 2 - np.mean(difference))
    odds = np.exp(np.array(log_odds) - max(log_odds))
    mean = odds @ scales / odds.sum()
    assert mean == pytest.approx(marginal.s_mean, abs=0.5 * marginal.s_std)
    assert np.sqrt(odds @ (scales - mean) ** 2 / odds.sum()) == pytest.approx(marginal.s_std, rel=0.1)


@pytest.mark.parametrize(("nonlinearity", "record"), EXAMPLES)
def test_gradients_are_those_of_the_values(nonlinearity, record):
    likelihoods = found(nonlinearity, record)
    std = np.sqrt(np.diag(np.linalg.inv(likelihoods.marginal.curvature)))
    for likelihood in (likelihoods.marginal, likelihoods.conditional):
        for s in (-8.0, 0.0, 2.5, 7.0):
            theta, at = likelihood.peak + std, s * likelihood.s_std
            _, by_theta, by_s = likelihood.evaluate(theta, at)
            for i, width in enumerate(std):
                step = 1e-4 * width * np.eye(len(std))[i]
                rise = likelihood.evaluate(theta + step, at)[0] - likelihood.evaluate(theta - step, at)[0]
                assert 2e-4 * width * by_theta[i] == pytest.approx(rise, rel=1e-4, abs=1e-6)
            step = 1e-4 * likelihood.s_std
            rise = likelihood.evaluate(theta, at + step)[0] - likelihood.evaluate(theta, at - step)[0]
            assert 2.0 * step * by_s == pytest.approx(rise, rel=1e-4, abs=1e-6)


def test_the_marginal_is_wider_than_the_conditional_which_takes_the_motion_for_known():
    likelihoods = found("duffing", "force on both, three repeats")
    wide, narrow = (np.diag(np.linalg.inv(x.curvature)) for x in (likelihoods.marginal, likelihoods.conditional))
    assert np.all(wide > narrow)


def test_a_free_decay_tells_parameters_and_no_noise_of_a_force():
    structure, time = small_chain("linear", ndof=2), np.linspace(0.0, 20.0, 257)
    motion = simulate(structure, lambda t: np.zeros((len(t), 2)), time, initial=([0.5, 1.0], [0.0, 0.3]))
    record = Record(**Noise(30.0).added_to(motion).measurable, unforced=np.array([True, True]))
    scheme = Bayesian()
    trained = solved(scheme.pose(structure, [scheme.observe(record)]).alone)
    marginal = parameter_likelihoods(trained.evidence, trained.trained).marginal
    assert np.isnan(marginal.sigma_force).all()
    assert marginal.evaluate(marginal.peak, 0.5)[0] == pytest.approx(marginal.evaluate(marginal.peak, -0.5)[0])
    std = np.sqrt(np.diag(np.linalg.inv(marginal.curvature)))
    np.testing.assert_array_less(np.abs(marginal.peak - [1.0, 1.0, 15.0, 15.0]), 4.0 * std)
    np.testing.assert_array_less(std, [0.1, 0.1, 0.5, 0.5])


@pytest.mark.parametrize("record", RECORDS)
def test_what_the_motion_takes_and_how_that_changes_with_the_parameters(record):
    """The motion following them: against a network that is trained with the parameters held elsewhere."""
    likelihoods, dense = found(record=record), DenseModel(example(record=record))
    peak = likelihoods.marginal.peak
    np.testing.assert_allclose(likelihoods.force, dense.force(peak), atol=2e-3 * np.abs(likelihoods.force).max())
    for q in np.eye(len(peak)) * 0.3:
        theta = deviations(likelihoods.marginal, q)
        expected = dense.force(theta) - dense.force(peak)
        given = likelihoods.force_by_parameter @ (theta - peak)
        np.testing.assert_allclose(given, expected, atol=0.05 * np.abs(expected).max())


def test_numbers_of_a_load_cell_are_among_the_parameters_of_the_marginal():
    """As far as they are known with all else: the same solution's standard deviations are the yardstick."""
    structure = small_chain("linear", ndof=2)
    record = measured(structure, snr_db=30.0, duration=24.0, samples=385).record
    shown = 1.2 * record.force[:, 0]
    doubts = {kind: unknown_calibration(kind, record.time, shown) for kind in ("gain", "offset")}
    cell = Channel("f", "force", {0: 1.0}, record.time, shown, doubts)
    record = replace(record, force=record.force * [1.2, 0.0], calibrated=(cell,))
    problem = Bayesian(unknown=["k_*"]).pose(structure, [record])
    estimate = by_spline(problem)
    marginal = estimate.likelihoods.marginal
    assert marginal.names == ("k_1", "k_2", "gain_f", "offset_f")
    assert np.isnan(marginal.sigma_force).all()  # its noise is that of a sensor, and stays as it was found
    std = np.sqrt(np.diag(np.linalg.inv(marginal.curvature)))
    by_name = {p.name: p for p in estimate.parameters}
    for name, peak, deviation in zip(marginal.names, marginal.peak, std, strict=True):
        truth = {"gain_f": 1.2, "offset_f": 0.0}.get(name, 15.0)
        assert abs(peak - truth) < 4.0 * deviation
        if name not in ("k_1", "k_2"):  # what misfit may do to springs is added to theirs
            assert deviation == pytest.approx(by_name[name].std, rel=0.02)
    assert marginal.evaluate(marginal.peak, 0.0)[0] == marginal.evaluate(marginal.peak, 1.0)[0]
