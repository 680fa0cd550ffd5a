"""Gauss-Newton's convergence, and a linear chain against dense weighted least squares."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from one_record import evidence_of, levels_of, problem_of, residuals_of, weights_of
from small_problems import accelerations, believed, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.factors import ridge
from pinn_cli.training.least_squares import LeastSquares
from pinn_cli.training.minimise import Point, minimise
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.bordered import SharedSystem


def posed(nonlinearity: str, ndof: int = 3, uncertain: bool = False) -> tuple[NormalEquations, NoiseModel]:
    structure = small_chain(nonlinearity, ndof)
    record = accelerations(measured(structure, snr_db=40.0, duration=6.0, samples=65).record, tuple(range(1, ndof + 1)))
    stiffnesses = believed(structure, *(("k", dof) for dof in range(ndof)), share=0.075)
    problem = Problem(structure, record, stiffnesses if uncertain else ())
    nothing = np.full(ndof, np.nan)
    levels = {"displacement": nothing, "velocity": nothing, "acceleration": np.full(ndof, 0.01)}
    noise = NoiseModel(levels, np.where(record.sensors("force"), 0.02, np.nan), 0.03, 1.0)
    return NormalEquations(Spline(intervals=12).build(record), problem), noise


def minimised(equations: NormalEquations, noise: NoiseModel, start: Point, *limits, **settings):
    return minimise(problem_of(equations), levels_of(noise), start, *limits, **settings)


def solved(equations: NormalEquations, noise: NoiseModel, **settings):
    options = {"iterations": 30, "tolerance": 1e-12, "watch": lambda terms: None, **settings}
    return minimised(equations, noise, equations.start(), **options)


def weighted_residuals(equations: NormalEquations, noise: NoiseModel):
    """All residuals over their standard deviations, with the prior's, of the unknowns and parameters in one vector."""
    weights, size = weights_of(equations, noise), equations.layout.size

    def residuals(z):
        terms = residuals_of(equations, Point(z[:size], z[size:])).items()
        return torch.cat([(r * weights[name].sqrt()).flatten() for name, r in terms] + [z[size:]])

    return residuals


def joined(point: Point) -> torch.Tensor:
    return torch.cat((point.unknowns, point.parameters))


def jacobian(function, z: torch.Tensor) -> torch.Tensor:
    return torch.autograd.functional.jacobian(function, z, vectorize=True).flatten(0, -2)


@pytest.mark.parametrize("ndof", [1, 3])
def test_a_linear_chain_is_solved_by_weighted_least_squares(ndof):
    equations, noise = posed("linear", ndof)
    solution = solved(equations, noise)
    residuals, zero = weighted_residuals(equations, noise), joined(equations.start())
    expected = torch.linalg.lstsq(jacobian(residuals, zero), -residuals(zero)[:, None], driver="gelsd").solution[:, 0]
    found, wanted = (
        equations.flat_states(equations.observation, p) for p in (solution.point, Point(expected, zero[:0]))
    )
    for given, truth in zip(found[:3], wanted[:3], strict=True):
        torch.testing.assert_close(given, truth, rtol=1e-6, atol=1e-6 * truth.abs().max().item())
    assert solution.converged
    assert solution.factor is not None
    assert solution.iterations <= 3
    assert solution.loss == pytest.approx(float(residuals(joined(solution.point)).square().sum()), rel=1e-9)


# Cubic springs pull harder the further a start is off: it has to be close for seven whole steps to do.
@pytest.mark.parametrize(("nonlinearity", "away"), [("duffing", 0.3), ("van_der_pol", 3.0)])
def test_convergence_is_quadratic_where_the_model_is_exact(nonlinearity, away):
    equations, noise = posed(nonlinearity, uncertain=True)
    # A record that a point of the network fits exactly, so that Gauss-Newton is Newton there.
    there = solved(equations, noise, tolerance=1e-6).point
    motion = equations.flat_states(equations.physics, there)[:3]
    force = equations.dynamics.structure.external_force(*motion, equations.parameters(there)).numpy()
    record = replace(equations.problem.record, acceleration=motion[2].numpy(), displacement=motion[0].numpy(),
                     force=force, unforced=np.zeros(3, bool))  # fmt: skip
    exact = NormalEquations(equations.network, replace(equations.problem, record=record))
    exact.ridge.value = 0.0  # it would move the solution away from the one that the record was made of
    level = np.full(3, 0.01)
    noise = NoiseModel({"displacement": level, "velocity": np.full(3, np.nan), "acceleration": level}, level, 0.01, 1.0)
    whole, levels = problem_of(exact), levels_of(noise, spread=1e6)
    truth = joined(there)
    generator = torch.Generator().manual_seed(3)
    shift = away * truth.abs().mean() * torch.randn(len(truth), generator=generator, dtype=truth.dtype)
    point = there.moved((shift[: exact.layout.size], shift[exact.layout.size :]))
    errors = []
    for _ in range(7):
        system = whole.assemble(point, levels)
        point = point.moved(tuple(torch.as_tensor(x) for x in system.factor().step(system)))
        errors.append(
            float((exact.flat_states(exact.physics, point).displacement - motion[0]).norm() / motion[0].norm())
        )
    # Above rounding, an error is a constant times the square of the one before.
    steps = zip(errors, errors[1:], errors[2:], strict=False)
    slopes = [np.log(c / b) / np.log(b / a) for a, b, c in steps if b < 0.1 and c > 1e-12]
    assert min(errors) < 1e-12, errors
    assert slopes, errors
    assert slopes[-1] == pytest.approx(2.0, abs=0.4), errors


def test_every_accepted_step_lowers_the_loss():
    equations, noise = posed("duffing")
    losses: list[float] = []
    solution = solved(equations, noise, watch=lambda terms: losses.append(sum(terms.values())))
    assert len(losses) == solution.iterations
    assert all(after <= before * (1 + 1e-9) for before, after in pairwise(losses))
    assert losses[-1] == solution.loss


def test_it_says_that_it_ran_out_of_steps():
    solution = solved(*posed("duffing"), iterations=1)
    assert not solution.converged
    assert solution.factor is None
    assert solution.iterations == 1


def test_a_loss_that_is_not_finite_at_the_start_is_divergence():
    equations, noise = posed("linear")
    with pytest.raises(DivergenceError, match="not finite at the start"):
        minimised(equations, noise, equations.start().moved((np.inf, 0.0)), 3, 1e-6, lambda terms: None)


def softening(positive: bool, prescribed: float = 50.0, prior_std: float = 100.0) -> tuple[NormalEquations, NoiseModel]:
    """A chain whose second spring softens, and an estimator that takes it to harden."""
    structure = small_chain()
    kappa = torch.tensor([100.0, -40.0, 100.0], dtype=torch.float64)
    record = accelerations(
        measured(structure.with_parameters(kappa=kappa), snr_db=50.0, duration=20.0, samples=257).record, (1, 2, 3)
    )
    prior = Parameter("kappa", 1, prescribed, prior_std, positive=positive)
    kappa = kappa.clone()
    kappa[1] = prescribed
    stiffness = Parameter("k", 1, 15.0, 1.0)
    problem = Problem(structure.with_parameters(kappa=kappa), record, (stiffness, prior) if prior_std else (stiffness,))
    nothing, level = np.full(3, np.nan), np.full(3, 0.002)
    noise = NoiseModel(
        {"displacement": nothing, "velocity": nothing, "acceleration": level},
        np.where(record.sensors("force"), 0.004, np.nan), 0.004, 1.0,
    )  # fmt: skip
    return NormalEquations(Spline(intervals=100).build(record), problem), noise


@pytest.mark.parametrize("prescribed", [0.0, 7.3, 50.0, 123.4])
def test_a_parameter_that_cannot_be_negative_ends_exactly_at_zero(prescribed):
    equations, noise = softening(True, prescribed)
    solution = solved(equations, noise)
    assert solution.converged
    assert solution.point.parameters[1] == equations.lower[1]
    assert float(equations.parameters(solution.point)["kappa"][1]) == pytest.approx(0.0, abs=1e-13 * prescribed)
    # It would like to go on, and nothing else would.
    slope = equations.assemble(solution.point, noise, np.eye(2)).corner_gradient
    assert slope[1] > 0
    assert abs(slope[0]) < 1e-3 * slope[1]


def test_at_its_bound_a_parameter_is_one_that_is_held_at_zero():
    bounded, held = (solved(*softening(True, *settings)) for settings in ((50.0, 100.0), (0.0, 0.0)))
    # The prior of the bounded one counts its way from 50 to 0.
    assert bounded.loss == pytest.approx(held.loss + (50.0 / 100.0) ** 2, rel=1e-6)
    torch.testing.assert_close(bounded.point.parameters[:1], held.point.parameters, rtol=1e-4, atol=1e-5)


def counted_factorisations(monkeypatch) -> list[float]:
    """The dampings of all factorisations, -1 for those with the parameters held."""
    found: list[float] = []
    factor, held = SharedSystem.factor, SharedSystem.readout_step
    monkeypatch.setattr(SharedSystem, "factor", lambda s, damping=0.0: found.append(damping) or factor(s, damping))
    monkeypatch.setattr(SharedSystem, "readout_step", lambda s: found.append(-1.0) or held(s))
    return found


def test_a_cautious_solution_is_the_same(monkeypatch):
    equations, noise = posed("duffing", uncertain=True)
    bold, careful = (
        minimised(equations, noise, equations.start(), 40, 1e-9, lambda terms: None, cautious)
        for cautious in (False, True)
    )
    assert bold.converged
    assert careful.converged
    assert careful.loss == pytest.approx(bold.loss, rel=1e-8)
    assert careful.factor is not None


def test_where_a_whole_step_promises_nothing_it_is_the_end(monkeypatch):
    equations, noise = posed("duffing", uncertain=True)
    there = solved(equations, noise).point
    found, losses = counted_factorisations(monkeypatch), LeastSquares.losses
    # Every step is a little worse, as where rounding is all that is left.
    monkeypatch.setattr(
        LeastSquares, "losses", lambda own, p, level: losses(own, p, level) | {"rounding": 0.0 if p is there else 1e-3}
    )
    solution = minimised(equations, noise, there, 40, 1e-6, lambda terms: None)
    assert solution.converged
    assert solution.point is there
    assert found == [0.0]


def test_a_factor_of_nearly_the_same_problem_serves_until_the_end(monkeypatch):
    """Only the Hessian of the solution is factored anew, and it is that of the end."""
    equations, noise = posed("duffing", uncertain=True)
    before = solved(equations, noise, tolerance=1e-6)
    assert before.chord is not None
    louder = replace(noise, force=1.05 * noise.force, discrepancy=1.05 * noise.discrepancy)
    found = counted_factorisations(monkeypatch)
    quick = minimised(equations, louder, before.point, 40, 1e-6, lambda terms: None, near=before.chord)
    assert quick.converged
    assert found == [0.0]
    afresh = minimised(equations, louder, before.point, 40, 1e-9, lambda terms: None)
    assert quick.loss == pytest.approx(afresh.loss, rel=3e-6)
    assert quick.factor is not None
    expected = problem_of(equations).assemble(quick.point, levels_of(louder)).factor()
    of_end, of_expected = (x.parameter_log_determinant + sum(x.determinants) for x in (quick.factor, expected))
    assert of_end == pytest.approx(of_expected, abs=0.05)


@pytest.mark.parametrize("factor", [1e-4, 1e4])
def test_a_factor_of_another_problem_misleads_nobody(factor):
    """Levels a hundredfold off: steps with that factor are far too long or too short."""
    equations, noise = posed("duffing", uncertain=True)
    other = replace(noise, force=noise.force * factor, discrepancy=noise.discrepancy * factor)
    chord = solved(equations, other, tolerance=1e-6).chord
    start = equations.start()
    found = minimised(equations, noise, start, 40, 1e-6, lambda terms: None, near=chord)
    expected = minimised(equations, noise, start, 40, 1e-6, lambda terms: None)
    assert found.converged
    assert found.loss == pytest.approx(expected.loss, rel=1e-5)


def test_rounds_of_nearly_the_same_noise_share_a_factor(monkeypatch):
    """In a record's settling of noise levels most solutions take one factorisation."""
    equations, noise = posed("duffing", uncertain=True)
    taken: list[int] = []
    evidence, levels = evidence_of(equations, count=taken.append), levels_of(noise)
    trained = evidence.train(levels, equations.start())
    for louder in (1.02, 1.04, 1.06):
        changed = levels.with_discrepancy(louder * noise.discrepancy)
        trained = evidence.train(changed, trained.solution.point, goes_on=True)
        assert trained.solution.converged
        assert trained.solution.chord is None
    assert taken[1:] == [1, 1, 1]


def test_a_start_far_from_rest_counts_the_ridge_that_hangs_on_its_own_first_matrix(monkeypatch):
    monkeypatch.setattr(ridge, "RELATIVE_RIDGE", 1e-6)
    equations, noise = posed("linear")
    before = solved(equations, noise)
    again, _ = posed("linear")  # has no ridge yet
    noise = replace(noise, discrepancy=0.029)
    found = minimised(again, noise, before.point, 30, 1e-12, lambda terms: None)
    assert found.converged
    assert found.loss == pytest.approx(sum(problem_of(again).losses(found.point, levels_of(noise)).values()))
