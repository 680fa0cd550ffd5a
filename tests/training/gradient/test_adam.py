"""First-order training and its loss weights, on records so small that a step takes a millisecond."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_problems import QUANTITIES, accelerations, believed, measured, relative_error, small_chain, sped_up

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.losses import LearnedParameters, Losses, Objective

DESIGNS = {
    "mlp": Mlp(2, 32, "sine"),
    "mlp-exact": Mlp(2, 32, "sine", "exact"),
    "spline": Spline(),
    "fourier": Fourier(),
    "fourier-penalised": Fourier(continuity="penalised"),
}


def small_problem(hold: str = "exact", **settings) -> Problem:
    structure = small_chain()
    return Problem(structure, accelerations(measured(structure, hold, snr_db=40.0).record), **settings)


def trained(training: Adam, name: str = "mlp", problem: Problem | None = None, seed: int = 0) -> Estimate:
    return training.solve(JointProblem.of(problem or small_problem()), DESIGNS[name], RunContext(seed=seed))


def short(**settings) -> Adam:
    return Adam(**{"iterations": 20, "collocation_points": 128, "history_every": 10, **settings})


@pytest.mark.parametrize(("name", "hold"), [*zip(DESIGNS, itertools.cycle(("exact", "zero_order")), strict=False)])
def test_the_loss_falls(name, hold):
    training = short(iterations=150, stages=1, learning_rate=5e-3)
    estimate = trained(training, name, small_problem(hold))
    losses = estimate.history.filter(like="loss_").sum(axis=1).to_numpy()
    assert losses[-1] < 0.3 * losses[0]
    assert estimate.summary["loss"] == pytest.approx(losses[-1])
    for quantity in (*QUANTITIES, "force"):
        values = getattr(estimate.response, quantity)
        assert values.shape == (257, 3)
        assert values.dtype == np.float64
        assert np.isfinite(values).all()
        assert np.isnan(getattr(estimate.std, quantity)).all()


def test_the_same_seed_gives_the_same_numbers():
    before = torch.get_rng_state()
    estimates = [trained(short(), seed=seed) for seed in (5, 5, 6)]
    assert torch.equal(before, torch.get_rng_state())
    for quantity in (*QUANTITIES, "force"):
        first, same, other = (getattr(estimate.response, quantity) for estimate in estimates)
        assert np.array_equal(first, same)
        assert not np.array_equal(first, other)
    first, same = (estimate.history.drop(columns="seconds") for estimate in estimates[:2])
    assert first.equals(same)


def test_the_history_has_a_row_every_so_often_and_at_the_end():
    history = trained(short(iterations=12, stages=2)).history
    assert history["iteration"].tolist() == [0, 10, 20, 24]
    assert history["seconds"].is_monotonic_increasing
    names = ("observation", "continuity", "forced", "unforced")
    assert list(history)[2:] == [f"loss_{name}" for name in names] + [f"weight_{name}" for name in names]
    assert history["weight_observation"].tolist() == [1.0] * 4
    assert history["weight_continuity"].tolist() == [10.0] * 4
    # The equations of motion weigh ten times as much in the second stage.
    assert history["weight_forced"].tolist() == history["weight_unforced"].tolist() == [100.0, 100.0, 1000.0, 1000.0]


def test_a_network_with_exact_continuity_has_no_such_term():
    history = trained(short(), "mlp-exact").history
    assert not [name for name in history if "continuity" in name]


def test_unforced_dofs_may_have_a_weight_of_their_own():
    weights = {}, {"unforced": 2.0}, {"physics": 50.0}
    histories = [trained(short(stages=1, weights=given)).history for given in weights]
    assert [history["weight_unforced"][0] for history in histories] == [100.0, 2.0, 50.0]
    assert [history["weight_forced"][0] for history in histories] == [100.0, 100.0, 50.0]
    plain, lighter = (history["loss_unforced"][0] for history in histories[:2])
    assert lighter == pytest.approx(0.02 * plain, rel=1e-5)


@pytest.mark.parametrize("through", ["derivative", "observer", "both"])
def test_accelerations_are_observed_as_the_problem_says(through):
    weights = {"observation": 1.0, "continuity": 0.0, "physics": 0.0}
    training = short(iterations=150, stages=1, learning_rate=1e-2, weights=weights, dtype="float64")
    problem = small_problem(acceleration_through=through)
    estimate = trained(training, "mlp-exact", problem)
    by_derivative = relative_error(estimate.response.acceleration[:, :2], problem.record.acceleration[:, :2])
    # Without physics the derivative is bound to the sensors only if it is what is compared with them.
    assert (by_derivative < 0.7) == (through != "observer")
    assert estimate.history["loss_observation"].iloc[-1] < 0.5 * estimate.history["loss_observation"].iloc[0]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("learning_rate", [1e3, 1e30])
def test_divergence_says_where_and_what_to_try(learning_rate, dtype):
    training = short(learning_rate=learning_rate, dtype=dtype, iterations=200)
    with pytest.raises(DivergenceError) as error:
        trained(training)
    assert "loss_" in str(error.value)
    assert "at iteration" in str(error.value)
    assert f"training.learning_rate below {learning_rate:g}" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["mlp", "spline", "fourier-penalised"])
def test_nothing_rests_on_the_time_scale(name):
    slow, fast = small_chain(), small_chain(speed=30.0)
    record = accelerations(measured(slow, snr_db=40.0).record)
    training = short(dtype="float64")
    problems = [
        Problem(structure, given, believed(structure, ("k", 1), ("c", 2)))
        for structure, given in ((slow, record), (fast, sped_up(record, 30.0)))
    ]
    expected, given = (trained(training, name, problem) for problem in problems)
    scale = np.abs(expected.response.displacement).max()
    np.testing.assert_allclose(given.response.displacement, expected.response.displacement, atol=1e-5 * scale)
    for mine, theirs in zip(given.parameters, expected.parameters, strict=True):
        assert mine.estimate / mine.prescribed == pytest.approx(theirs.estimate / theirs.prescribed, rel=1e-6)


@pytest.mark.parametrize("name", ["mlp", "spline"])
def test_clock_times_do_no_harm_in_float32(name):
    problem = small_problem()
    step = 2.0**-4  # clock times near 1.7e9 s hold it exactly
    early = replace(problem, record=replace(problem.record, time=step * np.arange(257)))
    late = replace(problem, record=replace(problem.record, time=1.7e9 + step * np.arange(257)))
    expected, given = (trained(short(), name, each) for each in (early, late))
    assert np.array_equal(given.response.displacement, expected.response.displacement)
    assert given.response.time[0] == 1.7e9


def test_the_progress_bar_is_quiet_where_there_is_no_terminal(capfd):
    short().solve(JointProblem.of(small_problem()), DESIGNS["mlp"], RunContext(progress=True))
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


@pytest.mark.parametrize("snr_db", [None, 10.0])
def test_points_are_judged_by_the_signal_and_not_by_its_noise(snr_db):
    structure = small_chain()
    # 15 periods of the highest frequency of the force: two points in each, and a little more.
    problem = Problem(structure, accelerations(measured(structure, snr_db=snr_db).record))
    trained(short(collocation_points=40), problem=problem)
    with pytest.raises(InputError, match=r"training\.collocation_points=20: must be a whole number >= \d+, or null"):
        trained(short(collocation_points=20), problem=problem)


def objective() -> Objective:
    problem = small_problem()
    network = Mlp(1, 16, "sine").build(problem.record)
    parameters = LearnedParameters(problem, torch.float64)
    return Objective(Losses(problem, 128, "cpu", torch.float64), network, parameters, "equalised")


def gradient_norms(given: Objective) -> dict[str, float]:
    norms = {}
    for name, term in given().terms.items():
        parts = torch.autograd.grad(term, list(given.network.parameters()), retain_graph=True, allow_unused=True)
        norms[name] = math.sqrt(sum(float(part.square().sum()) for part in parts if part is not None))
    return norms


def test_equalised_terms_pull_equally_hard_at_the_start():
    given = objective()
    given.begin_stage(0, 1.0)
    norms = gradient_norms(given)
    assert set(norms) == {"observation", "continuity", "forced", "unforced"}
    assert all(norm == pytest.approx(norms["observation"], rel=1e-9) for norm in norms.values())
    assert given().weights["observation"] == 1.0


def test_the_history_has_the_weights_that_were_found():
    training = short(iterations=10, weights="equalised", history_every=5)
    history = training.solve(JointProblem.of(small_problem()), Mlp(1, 16, "sine"), RunContext()).history
    assert history["iteration"].tolist() == [0, 5, 10, 15, 20]
    # The row at the border of two stages has the second one's weights.
    expected = history["weight_unforced"][0] * np.array([1.0, 1.0, 10.0, 10.0, 10.0])
    np.testing.assert_allclose(history["weight_unforced"], expected)
    assert set(history["weight_observation"]) == {1.0}
    assert history["weight_continuity"].nunique() == 1
