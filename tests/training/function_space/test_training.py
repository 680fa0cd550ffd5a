"""Training an MLP in function space, on records that take a step well under a second, and its collocation points."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from calls import Compose
from small_problems import QUANTITIES, accelerations, believed, measured, relative_error, small_chain, sped_up

from pinn_cli.cli.config import RunConfig
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.physics import targets
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.function_space.search import FunctionSpaceSearch
from pinn_cli.training.function_space.training import Collocation, collocate
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.history import train

SMALL = Mlp(1, 12, "sine", "exact", "fourier")


UNCERTAIN = ("c", 1), ("k", 1), ("kappa", 1)


def problem(hold: str = "exact", snr_db: float = 40.0, seed: int = 0, **settings) -> Problem:
    structure = small_chain()
    return Problem(structure, accelerations(measured(structure, hold, snr_db=snr_db, seed=seed).record), **settings)


def truth(hold: str = "exact"):
    return measured(small_chain(), hold).truth.response


def solved(given: Problem, design: Mlp = SMALL, seed: int = 0, **settings) -> Estimate:
    return GaussNewton(**settings).solve(JointProblem.of(given), design, RunContext(seed=seed))


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_it_recovers_the_motion(hold):
    estimate = solved(problem(hold))
    for quantity in QUANTITIES:
        error = relative_error(getattr(estimate.response, quantity), getattr(truth(hold), quantity))
        assert error < 0.03, quantity
    assert estimate.summary["stop_reason"] == "converged"
    assert estimate.history["iteration"].tolist() == list(range(len(estimate.history)))


def test_accelerations_through_the_observer():
    estimate = solved(problem(acceleration_through="both"))
    assert relative_error(estimate.response.velocity, truth().velocity) < 0.03


@pytest.mark.parametrize(
    "design",
    [
        pytest.param(Mlp(1, 12, "tanh", "exact", "fourier"), id="tanh", marks=pytest.mark.slow),
        pytest.param(Mlp(1, 16, "sine", "penalised", "fourier"), id="penalised"),
        pytest.param(Mlp(2, 12, "silu", "exact", "fourier"), id="two layers of silu", marks=pytest.mark.slow),
        pytest.param(Mlp(2, 24, "sine", "exact"), id="without embedding"),
    ],
)
@pytest.mark.slow
def test_other_networks(design):
    assert relative_error(solved(problem(), design).response.displacement, truth().displacement) < 0.05


@pytest.mark.slow
def test_another_seed_finds_the_same_motion():
    first, second = (solved(problem(), seed=seed).response for seed in (0, 1))
    assert relative_error(first.displacement, second.displacement) < 0.01
    assert not np.array_equal(first.displacement, second.displacement)


@pytest.mark.slow
def test_it_does_not_know_the_unit_of_time():
    slow = problem()
    fast = Problem(small_chain(speed=50.0), sped_up(slow.record, 50.0))
    expected = solved(slow, iterations=4).response.displacement
    np.testing.assert_allclose(solved(fast, iterations=4).response.displacement, expected, rtol=1e-4, atol=1e-6)


def test_uncertain_parameters_are_learned_with_their_standard_deviations():
    structure = small_chain()
    wrong = replace(
        structure, parameters={**structure.parameters, "k": structure.parameters["k"] * torch.tensor([1.0, 1.06, 1.0])}
    )
    given = Problem(wrong, problem().record, believed(wrong, *UNCERTAIN))
    estimate = solved(given)
    k = next(p for p in estimate.parameters if p.name == "k_2")
    assert abs(k.estimate - 15.0) < 0.1
    assert abs(k.estimate - 15.0) < 5.0 * k.std
    assert 0.0 < k.std < 0.3
    assert k.lower_90 < k.estimate < k.upper_90
    assert estimate.correlation is not None
    np.testing.assert_allclose(np.diag(estimate.correlation), 1.0)


def test_an_unknown_parameter_is_identified():
    structure = small_chain()
    start = Parameter("k", 1, 5.0, 150.0, scale=5.0, unknown=True, positive=True)
    prescribed = replace(structure, parameters={**structure.parameters, "k": torch.tensor([15.0, 5.0, 15.0]).double()})
    found = solved(Problem(prescribed, problem().record, (start,))).parameters[0]
    assert found.estimate == pytest.approx(15.0, rel=0.01)


def test_a_training_that_was_stopped_goes_on_with_the_same_numbers(monkeypatch):
    """Every state on the way is taken from one training and given to a fresh one."""
    given = problem(uncertain=believed(small_chain(), *UNCERTAIN, share=0.05))
    whole = solved(given, iterations=6)
    states: list[dict[str, Any]] = []

    def stop_after_two(training: FunctionSpaceSearch, run: RunContext) -> None:
        for _ in range(2):
            training.step()
        states.append(training.state_dict())

    def go_on(training: FunctionSpaceSearch, run: RunContext) -> None:
        training.load_state_dict(states[0])
        train(training, run)

    for replacement in (stop_after_two, go_on):
        monkeypatch.setattr("pinn_cli.training.function_space.training.train", replacement)
        estimate = solved(given, iterations=6)
    np.testing.assert_array_equal(estimate.response.displacement, whole.response.displacement)
    assert [p.estimate for p in estimate.parameters] == [p.estimate for p in whole.parameters]
    columns = [name for name in whole.history if name != "seconds"]
    np.testing.assert_array_equal(estimate.history[columns], whole.history[columns])


def test_a_step_that_gains_little_is_taken_all_the_same():
    """Whole steps are refused on the way; what shares of them gain is less than the tolerance."""
    estimate = solved(problem(snr_db=30.0), Mlp(2, 24, "sine", "exact"), tolerance=0.3)
    assert estimate.summary["stop_reason"] == "converged"


def test_the_iteration_limit_is_kept():
    estimate = solved(problem(), iterations=2)
    assert estimate.summary["stop_reason"] == "iteration limit"
    assert estimate.summary["iterations"] == 2


def test_the_force_that_acts_is_between_the_motions_and_the_measured_one():
    structure = small_chain("linear")
    estimate = solved(Problem(structure, problem(snr_db=50.0).record))
    force = truth().force
    assert relative_error(estimate.response.force[:, 0], force[:, 0]) < 0.05


@pytest.mark.parametrize("setting", [{"collocation_points": 100}, {"most_residuals": 500}])
def test_settings_of_an_mlp_are_refused_with_a_linear_readout(setting):
    with pytest.raises(
        InputError, match=r"training\.\w+=\d+: must be left as it is, .*; network=spline has a linear readout"
    ):
        solved(problem(), Spline(), **setting)  # type: ignore[arg-type]


def test_the_defaults_of_the_class_are_those_of_the_configuration(composed: Compose):
    assert vars(RunConfig.read(composed("network=mlp")).training) == vars(GaussNewton())


def covered(estimate: Estimate, quantity: str) -> float:
    error = getattr(estimate.response, quantity) - getattr(truth(), quantity)
    return float(np.mean(np.abs(error) <= 1.96 * getattr(estimate.std, quantity)))


def test_bands_cover_under_a_wrong_model():
    """A linear chain, where the true one is Duffing's."""
    structure = small_chain("linear")
    given = Problem(structure, problem(snr_db=50.0).record, believed(structure, *UNCERTAIN[:2], share=0.075))
    estimate = solved(given)
    assert all(covered(estimate, quantity) > 0.85 for quantity in QUANTITIES)
    k = next(p for p in estimate.parameters if p.name == "k_2")
    assert abs(k.estimate - 15.0) < 3.0 * k.std


def long_problem(snr_db: float | None = 20.0, seed: int = 0) -> Problem:
    structure = small_chain()
    return Problem(structure, accelerations(measured(structure, snr_db=snr_db, samples=2049, seed=seed).record))


def collocated(given: Problem, points: int | None, most_rows: int) -> Collocation:
    return collocate(given, targets(given.record, Dynamics(given.structure)), points, most_rows)


def test_there_are_as_many_points_as_the_record_has_independent_values():
    given = long_problem()
    assert len(collocated(given, None, 10000).target.physics_time) == Spline().build(given.record).count


def test_few_residuals_take_fewer_points():
    fewer = collocated(long_problem(), None, 400).target
    assert len(fewer.physics_time) == 400 // 5  # two sensors, three equations of motion


def test_too_few_points_for_the_band_are_an_input_error():
    with pytest.raises(InputError, match=r"training.collocation_points=12: must be a whole number >= .* Hz"):
        collocated(long_problem(), 12, 10000)


def test_low_passing_takes_as_much_noise_out_as_it_says():
    noisy, clean = long_problem(), long_problem(snr_db=None)
    collocation = collocated(noisy, 150, 10000)
    samples = torch.linspace(0, 2048, 150).round().long()
    expected = targets(clean.record, Dynamics(clean.structure)).at(samples)
    for dof in range(2):
        error = (collocation.target.response["acceleration"] - expected.response["acceleration"])[:, dof]
        assert float(error.square().mean().sqrt()) == pytest.approx(collocation.response["acceleration"][dof], rel=0.35)
    force = (collocation.target.force - expected.force)[:, 0]
    assert float(force.square().mean().sqrt()) == pytest.approx(collocation.force[0], rel=0.35)
    assert np.isnan(collocation.force[1:]).all()


def test_a_clean_record_stays_as_it_is():
    clean = long_problem(snr_db=None)
    collocation = collocated(clean, 150, 10000)
    whole = targets(clean.record, Dynamics(clean.structure)).at(torch.linspace(0, 2048, 150).round().long())
    found, expected = (each.response["acceleration"].numpy() for each in (collocation.target, whole))
    assert relative_error(found, expected) < 1e-3
