"""Estimates, standard deviations and intervals of parameters: against dense algebra, at bounds, and under misfit."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import evidence_of, levels_of, problem_of, residuals_of, shown_noise, weights_of
from scipy.stats import norm, truncnorm
from small_problems import accelerations, measured, small_chain

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import ParameterEstimate
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import updated_spread
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.reported.parameter_posterior import (
    bounded_estimates,
    coherent_misfit,
    parameter_force,
    parameter_posterior,
)
from pinn_cli.training.steps.discrepancy_search import scanned
from pinn_cli.training.steps.windows_discrepancy import widened

NINETY = norm.ppf(0.95)


def chain_with_kappa(*kappa: float) -> Structure:
    return small_chain().with_parameters(kappa=torch.tensor(kappa, dtype=torch.float64))


def unknown(kind: str, dof: int, start: float, std: float, positive: bool = True) -> Parameter:
    return Parameter(kind, dof, start, std, unknown=True, positive=positive)


def posed(true: Structure, model: Structure, uncertain: tuple[Parameter, ...], **settings) -> Evidence:
    """Accelerometers on DOFs 1 and 3, 50 dB, and parameters of the model that may move."""
    options = {"snr_db": 50.0, "duration": 20.0, "samples": 257, **settings}
    record = accelerations(measured(true, **options).record, (1, 3))
    values = {kind: value.clone() for kind, value in model.parameters.items()}
    for p in uncertain:
        values[p.kind][p.index] = p.prescribed
    problem = Problem(model.with_parameters(**values), record, uncertain)
    equations = NormalEquations(Spline(knots_per_period=4.0).build(record), problem)
    return evidence_of(equations, 40, 1e-9)


def solved(evidence: Evidence, discrepancy: float = 3e-4) -> Trained:
    (equations,) = evidence.equations.by_record
    noise = shown_noise(equations.problem.record, discrepancy, 1.0)
    trained = evidence.train(levels_of(noise), equations.start())
    assert trained.solution.converged
    return trained


def found(
    equations: NormalEquations, trained: Trained
) -> tuple[list[ParameterEstimate], np.ndarray, ParameterKnowledge]:
    evidence = evidence_of(equations)
    told = coherent_misfit(evidence.equations.columns, evidence.each_record(parameter_force, trained))
    return parameter_posterior(evidence.equations, trained, told)


def misfit_of(equations: NormalEquations, trained: Trained) -> np.ndarray:
    return found(equations, trained)[2].hidden / equations.scale.numpy()


def estimated(equations: NormalEquations, trained: Trained) -> tuple[list[ParameterEstimate], np.ndarray]:
    return found(equations, trained)[:2]


def dense_posterior(equations: NormalEquations, trained: Trained) -> tuple[np.ndarray, np.ndarray]:
    """Peak and covariance of the parameters, in prior standard deviations: every weighted residual differentiated."""
    weights, point = weights_of(equations, trained.noise.records[0]), trained.solution.point
    size = len(point.unknowns)
    precision = torch.cat((torch.full((size,), equations.ridge.value), problem_of(equations).precision(trained.noise)))

    def weighted(z):
        residuals = residuals_of(equations, Point(z[:size], z[size:])).items()
        return torch.cat([(r * weights[name].sqrt()).flatten() for name, r in residuals])

    z = torch.cat((point.unknowns, point.parameters))
    jacobian = torch.autograd.functional.jacobian(weighted, z, vectorize=True)
    hessian = jacobian.T @ jacobian + torch.diag(precision)
    unit = hessian.diagonal().rsqrt()
    inverse = torch.linalg.inv(hessian * unit * unit[:, None]) * unit * unit[:, None]
    peak = z - inverse @ (jacobian.T @ weighted(z) + precision * z)
    return peak[size:].detach().numpy(), inverse[size:, size:].numpy()


FREE = (
    Parameter("c", 0, 1.0, 0.1),
    unknown("k", 1, 20.0, 200.0),
    Parameter("k", 2, 14.0, 1.0),
    unknown("kappa", 1, 0.0, 1000.0, positive=False),
)


@pytest.fixture(scope="module")
def free() -> tuple[NormalEquations, Trained]:
    evidence = posed(small_chain(), small_chain(), FREE)
    return evidence.equations.by_record[0], solved(evidence)


def test_without_bounds_it_is_the_gaussian_of_the_dense_hessian(free):
    equations, trained = free
    estimates, correlation = estimated(equations, trained)
    _, covariance = dense_posterior(equations, trained)
    covariance = covariance + np.diag(misfit_of(equations, trained) ** 2)
    spread = np.sqrt(np.diag(covariance))
    for i, (given, p) in enumerate(zip(estimates, FREE, strict=True)):
        value = p.prescribed + p.prior_std * float(trained.solution.point.parameters[i])
        assert (given.name, given.prescribed, given.unknown) == (p.name, p.prescribed, p.unknown)
        assert given.estimate == pytest.approx(value)
        assert given.std == pytest.approx(p.prior_std * spread[i], rel=1e-4)
        assert given.lower_90 == pytest.approx(value - NINETY * given.std)
        assert given.upper_90 == pytest.approx(value + NINETY * given.std)
        assert given.prior_std == pytest.approx(p.prior_std)
    np.testing.assert_allclose(correlation, covariance / np.outer(spread, spread), atol=1e-4)
    np.testing.assert_allclose(np.diag(correlation), 1.0, rtol=1e-12)
    np.testing.assert_allclose(correlation, correlation.T, atol=1e-12)
    assert np.abs(correlation - np.eye(4)).max() > 0.1


def test_the_priors_are_those_of_the_user_whatever_spread_was_learned(free):
    equations, trained = free
    narrow = replace(trained, noise=replace(trained.noise, spread=0.3))
    estimates, _ = estimated(equations, narrow)
    assert [e.prior_std for e in estimates] == [p.prior_std for p in FREE]


def test_a_bound_far_below_leaves_the_interval_centred(free):
    far = (unknown("k", 1, 20.0, 200.0), unknown("kappa", 1, 10.0, 1000.0))
    evidence = posed(small_chain(), small_chain(), far)
    for given in estimated(evidence.equations.by_record[0], solved(evidence))[0]:
        assert given.estimate > 10.0 * given.std
        assert given.upper_90 - given.estimate == pytest.approx(NINETY * given.std, rel=1e-5)
        assert given.estimate - given.lower_90 == pytest.approx(NINETY * given.std, rel=1e-5)


@pytest.fixture(scope="module", params=[0.0, 123.4])
def held(request: pytest.FixtureRequest):
    """A softening spring that an estimator takes to harden, beside an unknown stiffness."""
    kappa = unknown("kappa", 1, request.param, 1000.0)
    evidence = posed(chain_with_kappa(100.0, -4.0, 100.0), small_chain(), (unknown("k", 1, 20.0, 200.0), kappa))
    trained = solved(evidence)
    (equations,) = evidence.equations.by_record
    return equations, trained, *physical(equations, trained)


def physical(equations: NormalEquations, trained: Trained) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of k and kappa, in their own units: peak and covariance without bounds, and what misfit adds."""
    peak, covariance = dense_posterior(equations, trained)
    unit = np.array([p.prior_std for p in equations.problem.uncertain])
    prescribed = np.array([p.prescribed for p in equations.problem.uncertain])
    return prescribed + unit * peak, covariance * np.outer(unit, unit), unit * misfit_of(equations, trained)


def test_at_its_bound_a_parameter_has_the_interval_of_the_truncated_gaussian(held):
    (_, kappa), _ = estimated(*held[:2])
    peak, covariance, misfit = held[2:]
    spread = np.hypot(covariance[1, 1] ** 0.5, misfit[1])
    assert -8.0 < peak[1] / spread < 0.0
    expected = truncnorm(-peak[1] / spread, np.inf, peak[1], spread)
    assert kappa.held
    assert kappa.estimate == pytest.approx(expected.mean(), rel=1e-3)
    assert 0.0 <= kappa.lower_90 < kappa.estimate < kappa.upper_90
    np.testing.assert_allclose([kappa.lower_90, kappa.upper_90], expected.ppf([0.05, 0.95]), rtol=1e-3)
    assert kappa.std == pytest.approx(expected.std(), rel=1e-3)


def test_beside_one_at_its_bound_a_parameter_has_an_interval_about_its_own_estimate(held):
    """Not about the place that it would have, were the other one free to go below zero."""
    (k, _), correlation = estimated(*held[:2])
    peak, covariance, misfit = held[2:]
    slope, spread = covariance[0, 1] / covariance[1, 1], covariance[1, 1] ** 0.5
    cut = truncnorm(-peak[1] / spread, np.inf, peak[1], spread)
    center = peak[0] + slope * (cut.mean() - peak[1])
    left = covariance[0, 0] + slope**2 * (cut.var() - spread**2) + misfit[0] ** 2
    assert (k.lower_90 + k.upper_90) / 2.0 == pytest.approx(center, abs=1e-3 * k.std)
    assert k.lower_90 < k.estimate < k.upper_90
    assert k.std == pytest.approx(left**0.5, rel=1e-3)
    together = (left * (cut.var() + misfit[1] ** 2)) ** 0.5
    assert correlation[0, 1] == pytest.approx(slope * cut.var() / together, rel=1e-3)


def test_misfit_is_the_discrepancy_over_the_force_of_one_prior_deviation():
    uncertain = tuple(
        Parameter(kind, 1, value, 0.1 * value)
        for kind, value in (("m", 10.0), ("c", 1.0), ("k", 15.0), ("kappa", 100.0))
    )
    evidence = posed(small_chain(), small_chain(), uncertain)
    (equations,), trained = evidence.equations.by_record, solved(evidence)
    motion = equations.flat_states(equations.physics, trained.solution.point)
    e, de = (x[:, 1] - x[:, 0] for x in motion[:2])
    per_unit = (motion[2][:, 1], de, e, e**3)
    force = [0.1 * p.prescribed * float(x.square().mean().sqrt()) for p, x in zip(uncertain, per_unit, strict=True)]
    # K coefficients of variance d^2 are a history of variance d^2 K / N.
    share = equations.network.count / len(equations.problem.record.time)
    hidden = trained.noise.discrepancy * share**0.5 / np.array(force)
    found = misfit_of(equations, trained)
    assert hidden.max() < 0.2
    np.testing.assert_allclose(found, hidden / np.sqrt(1.0 + hidden**2), rtol=1e-6)
    less = replace(trained, noise=trained.noise.with_discrepancy(1e-3 * trained.noise.discrepancy))
    np.testing.assert_allclose(misfit_of(equations, less), 1e-3 * hidden, rtol=1e-6)
    # The prior bounds what can hide.
    more = replace(trained, noise=trained.noise.with_discrepancy(1e6 * trained.noise.discrepancy))
    np.testing.assert_allclose(misfit_of(equations, more), 1.0, rtol=1e-3)
    # A discrepancy of few values has the same size as one of many.
    coloured = replace(trained, noise=trained.noise.each(lambda own: own.widened(0.2)))
    np.testing.assert_allclose(misfit_of(equations, coloured), found, rtol=1e-9)


@pytest.mark.parametrize(("duration", "names"), [(12.0, (1,)), (20.0, (1,)), (20.0, (0, 1, 2))])
def test_the_interval_of_a_stiffness_covers_it_where_the_model_forgets_the_cubic_springs(duration, names):
    """However long the record, the cubic force follows the motion as the linear one does, and makes k too large.

    The Hessian takes it for noise that averages out: by it alone the true stiffness of the springs at rest is far off.
    """
    stiffnesses = tuple(unknown("k", dof, 20.0, 200.0) for dof in names)
    evidence = posed(small_chain(), small_chain("linear"), stiffnesses, duration=duration)
    (equations,) = evidence.equations.by_record
    noise = levels_of(shown_noise(equations.problem.record, 1.0, 1.0))
    trained = widened(evidence, scanned(evidence, noise, 1.0, equations.start()))
    hessian = 200.0 * np.sqrt(np.diag(trained.factor.corner_covariance))
    estimates, _ = estimated(equations, trained)
    assert all(e.lower_90 < 15.0 < e.upper_90 for e in estimates)
    assert all(e.upper_90 - e.lower_90 < 15.0 for e in estimates)
    assert any(abs(e.estimate - 15.0) > NINETY * alone for e, alone in zip(estimates, hessian, strict=True))


@pytest.mark.parametrize("seed", range(60))
def test_every_estimate_lies_inside_its_interval(seed):
    """Bounds from far below the peak to far above it, correlations up to 0.9999, and misfit that hides them or not."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    mixed = rng.normal(size=(count, count)) + 10.0 ** rng.uniform(-1.0, 2.0) * np.ones((count, 1))
    unit = 10.0 ** rng.uniform(-6.0, 1.0, count)
    covariance = (mixed @ mixed.T + 1e-3 * np.eye(count)) * np.outer(unit, unit)
    spread = np.sqrt(covariance.diagonal())
    lower = np.where(rng.random(count) < 0.8, -np.abs(rng.normal(size=count)), -np.inf)
    reach = rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-1.0, 8.0, count)
    peak = np.where(np.isfinite(lower), lower, 0.0) + reach * spread
    misfit = rng.choice([0.0, 1.0]) * spread * 10.0 ** rng.uniform(-2.0, 2.0, count)
    uncertain = [
        Parameter("k", i, -float(low) if np.isfinite(low) else 1.0, 1.0, positive=bool(np.isfinite(low)))
        for i, low in enumerate(lower)
    ]
    mode = np.maximum(peak, lower)
    found = bounded_estimates(uncertain, np.ones(count), mode, TruncatedGaussian(peak, covariance, lower), misfit)
    for p, given in zip(uncertain, found, strict=True):
        assert given.lower_90 <= given.estimate <= given.upper_90
        assert given.lower_90 >= (0.0 if p.positive else -np.inf)
        assert given.std > 0.0


@pytest.mark.parametrize("below", [4.0, 40.0, np.inf])
def test_a_bound_that_is_far_leaves_the_mode_bit_for_bit(below):
    rng = np.random.default_rng(1)
    mode, unit = rng.normal(size=3) / 3.0, np.array([0.1, 3.0, 70.0])
    covariance = np.diag(np.full(3, 1e-4)) + 5e-5
    lower = mode - below * np.sqrt(covariance.diagonal())
    uncertain = [Parameter("k", dof, 1.1, 2.0) for dof in range(3)]
    found = bounded_estimates(uncertain, unit, mode, TruncatedGaussian(mode, covariance, lower))
    assert [p.estimate for p in found] == [1.1 + u * m for u, m in zip(unit, mode, strict=True)]
    assert not any(p.held for p in found)


def test_without_parameters_there_is_nothing():
    nothing = np.zeros(0)
    assert bounded_estimates([], nothing, nothing, TruncatedGaussian(nothing, np.zeros((0, 0)), nothing)) == []


INSIDE_90 = 1.645


def posterior(told: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
    """Means (p,) and standard deviation, in the user's, of parameters that a record tells to within ``noise``."""
    spread = 1.0
    for _ in range(200):
        variance = 1.0 / (spread**-2 + noise**-2)
        mean = variance * told / noise**2
        before, spread = spread, updated_spread(mean, np.full(len(told), variance), spread)
        if abs(spread / before - 1.0) < 1e-4:
            break
    return mean, float(np.sqrt(variance))


@pytest.mark.parametrize("noise", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("count", [1, 3, 12])
def test_intervals_hold_where_the_user_is_as_uncertain_as_he_says(count, noise):
    """Of one to twelve dampers that a record tells half they held 70 to 80 %: chance passed for a sharp user."""
    rng, held = np.random.default_rng(0), []
    for _ in range(1200 // count):
        truth = rng.standard_normal(count)
        mean, std = posterior(truth + noise * rng.standard_normal(count), noise)
        held.extend(np.abs(mean - truth) < INSIDE_90 * std)
    assert 0.82 < np.mean(held) < 0.96


def test_many_that_are_right_sharpen_each_other_and_wrong_ones_free_each_other():
    assert posterior(np.zeros(18), 0.5)[1] < 0.3
    mean, _ = posterior(np.array([8.0, -6.0, 7.0]), 0.5)
    assert mean == pytest.approx([8.0, -6.0, 7.0], rel=0.03)
