"""Every optimiser on a small problem, from its state on without a trace; L-BFGS on functions whose minimum is known."""

import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.optimize
import torch
from calls import SMALL, Compose
from small_problems import QUANTITIES, accelerations, believed, measured, relative_error, small_chain
from torch import Tensor, nn

from pinn_cli.cli.config import RunConfig
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.mlp import Mlp
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.lbfgs import GRADIENT_VANISHED, NOTHING_LOWER, Lbfgs, LbfgsSteps
from pinn_cli.training.gradient.losses import Objective
from pinn_cli.training.gradient.training import Optimiser

TRAININGS = {"adam": Adam, "lbfgs": Lbfgs}
NETWORK = Mlp(1, 12, "sine", "exact")


def small_problem() -> Problem:
    structure = small_chain()
    record = accelerations(measured(structure, snr_db=40.0).record)
    return Problem(structure, record, believed(structure, ("k", 1)))


@pytest.mark.parametrize("weights", [None, "equalised"])
@pytest.mark.parametrize("name", TRAININGS)
def test_going_on_from_a_state_changes_no_bit(name, weights, tmp_path):
    warm_up = {} if name == "adam" else {"warm_up": 3}
    settings = {"iterations": 12, "stages": 2, "collocation_points": 64, "history_every": 5, **warm_up}
    training, problem = TRAININGS[name](weights=weights, **settings), small_problem()
    whole = training.descent(problem, NETWORK, RunContext(seed=1))
    for _ in range(8):
        whole.step()
    torch.save(whole.state_dict(), tmp_path / "state.pt")
    resumed = training.descent(problem, NETWORK, RunContext(seed=2))
    resumed.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
    steps = 0
    while whole.step():
        steps += 1
        assert resumed.step()
        assert all(map(torch.equal, whole.objective.variables, resumed.objective.variables)), steps
    assert not resumed.step()
    assert steps == 16
    rows = [history.table().drop(columns="seconds") for history in (whole.history, resumed.history)]
    assert rows[0].equals(rows[1])


@pytest.mark.parametrize(
    ("training", "hold"),
    [
        (Adam(400, learning_rate=1e-2, collocation_points=None), "exact"),
        pytest.param(Adam(400, learning_rate=1e-2, collocation_points=None), "zero_order", marks=pytest.mark.slow),
        (Lbfgs(150, warm_up=0, collocation_points=None), "exact"),
    ],
    ids=["adam", "adam, zero order", "lbfgs"],
)
def test_it_finds_the_motion_where_all_is_measured(training, hold):
    structure = small_chain("linear", ndof=1)
    measurements = measured(structure, hold, snr_db=50.0)
    estimate = training.solve(JointProblem.of(Problem(structure, measurements.record)), Fourier(), RunContext())
    for quantity in (*QUANTITIES, "force"):
        truth = getattr(measurements.truth.response, quantity)
        assert relative_error(getattr(estimate.response, quantity), truth) < 0.03, quantity


@pytest.mark.slow
def test_curvature_gets_lower_than_adam_in_as_many_iterations():
    common = {"iterations": 300, "stages": 1, "collocation_points": 128}
    adam, lbfgs = (
        training.solve(JointProblem.of(small_problem()), NETWORK, RunContext()).summary["loss"]
        for training in (Adam(**common), Lbfgs(warm_up=50, **common))
    )
    assert lbfgs < 0.6 * adam


def test_a_row_of_the_history_is_never_higher_than_the_one_before():
    training = Lbfgs(iterations=60, warm_up=0, collocation_points=128, history_every=1)
    history = training.solve(JointProblem.of(small_problem()), NETWORK, RunContext()).history
    loss = history.filter(like="loss_").sum(axis=1).to_numpy()
    assert (np.diff(loss) <= 1e-12 * loss[:-1]).all()
    assert history["iteration"].tolist() == list(range(61))


@pytest.mark.parametrize("name", TRAININGS)
def test_the_defaults_of_the_class_are_those_of_the_configuration(composed: Compose, name):
    configured = RunConfig.read(composed("network=mlp", f"training={name}", *SMALL))
    assert vars(configured.training) == vars(TRAININGS[name]())
    assert vars(configured.network) == vars(Mlp(1, None, "sine", "exact", "fourier"))


class PlainObjective(Objective):
    """A function of one vector, whose last entries may have lower bounds."""

    def __init__(self, function: Callable[[Tensor], Tensor], start: Tensor, lower: tuple[float, ...] = ()) -> None:
        self.function, self.x, self._evaluation, self.physics_factor = function, nn.Parameter(start.clone()), None, 1.0
        self.weights = {"loss": 1.0}
        bounds = torch.tensor(lower, dtype=start.dtype)
        self.parameters = SimpleNamespace(count=len(lower), lower=bounds, respect_bounds=self.respect_bounds)
        self.visited: list[Tensor] = []

    def respect_bounds(self) -> None:
        with torch.no_grad():
            self.x.copy_(self.inside)

    @property
    def inside(self) -> Tensor:
        return torch.maximum(self.x, self.lower)

    @property
    def variables(self) -> list[nn.Parameter]:
        return [self.x]

    def terms(self) -> dict[str, Tensor]:
        self.visited.append(self.inside.detach().clone())
        return {"loss": self.function(self.inside)}


def minimise(optimiser: Optimiser, objective: PlainObjective, most: int) -> tuple[int, str]:
    """Iterations done and the reason to stop."""
    for iteration in range(most):
        reason = optimiser.step(objective, objective())
        if reason:
            return iteration, reason
    return most, ""


def rosenbrock(x: Tensor) -> Tensor:
    return (100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2).sum()


def quadratic(count: int, condition: float) -> tuple[Callable[[Tensor], Tensor], Tensor]:
    """A function with eigenvalues from 1 to ``condition``, and where it is least."""
    generator = torch.Generator().manual_seed(1)
    q, _ = torch.linalg.qr(torch.randn(count, count, generator=generator, dtype=torch.float64))
    matrix = q @ torch.diag(torch.logspace(0.0, math.log10(condition), count, dtype=torch.float64)) @ q.T
    bottom = torch.randn(count, generator=generator, dtype=torch.float64)
    return lambda x: 0.5 * (x - bottom) @ matrix @ (x - bottom), bottom


def test_rosenbrocks_valley_is_walked_as_fast_as_by_scipy():
    start = torch.tensor([-1.2, 1.0] * 3, dtype=torch.float64)
    objective = PlainObjective(rosenbrock, start)
    iterations, reason = minimise(LbfgsSteps(objective, 20, 1e-10), objective, 500)
    assert reason == GRADIENT_VANISHED
    assert torch.allclose(objective.x, torch.ones(6, dtype=torch.float64), atol=1e-9)
    theirs = scipy.optimize.minimize(
        scipy.optimize.rosen, start.numpy(), jac=scipy.optimize.rosen_der, method="BFGS", options={"gtol": 1e-10}
    )
    assert iterations <= 1.5 * theirs.nit


def test_a_quadratic_ends_in_a_few_times_its_dimension():
    function, bottom = quadratic(12, 1e3)
    objective = PlainObjective(function, torch.zeros(12, dtype=torch.float64))
    iterations, reason = minimise(LbfgsSteps(objective, 20, 1e-10), objective, 200)
    assert reason == GRADIENT_VANISHED
    assert iterations <= 100
    torch.testing.assert_close(objective.x.detach(), bottom, atol=1e-9, rtol=0.0)


def test_tiny_values_are_no_reason_to_stop():
    function, bottom = quadratic(6, 100.0)
    objective = PlainObjective(lambda x: 1e-12 * function(x), torch.zeros(6, dtype=torch.float64))
    minimise(LbfgsSteps(objective, 20, tolerance=1e-20), objective, 100)
    torch.testing.assert_close(objective.x.detach(), bottom, atol=1e-6, rtol=0.0)


def test_at_the_limit_of_digits_the_search_finds_nothing_lower():
    objective = PlainObjective(lambda x: 1.0 + rosenbrock(x), torch.tensor([-1.2, 1.0], dtype=torch.float64))
    iterations, reason = minimise(LbfgsSteps(objective, 20, tolerance=0.0), objective, 400)
    assert reason in (NOTHING_LOWER, GRADIENT_VANISHED)
    assert iterations < 400
    assert torch.allclose(objective.x, torch.ones(2, dtype=torch.float64), atol=1e-5)


def test_bounds_are_kept_and_the_bounded_minimum_is_found():
    # Within x_2 >= 2 Rosenbrock's function is least at (1.4, 2), within x_2 >= -1 at (1, 1).
    for lower, expected in ((2.0, math.nan), (-1.0, 1.0)):
        objective = PlainObjective(rosenbrock, torch.tensor([-1.2, 4.0], dtype=torch.float64), (lower,))
        _, reason = minimise(LbfgsSteps(objective, 20, tolerance=1e-8), objective, 300)
        assert reason
        assert min(float(x[1]) for x in objective.visited) >= lower
        bounds = [(None, None), (lower, None)]
        theirs = scipy.optimize.minimize(
            scipy.optimize.rosen, [-1.2, 4.0], jac=scipy.optimize.rosen_der, method="L-BFGS-B", bounds=bounds
        )
        assert float(rosenbrock(objective.x.detach())) <= theirs.fun + 1e-6
        if not math.isnan(expected):
            assert float(objective.x.detach()[1]) == pytest.approx(expected, abs=1e-6)
        else:
            assert float(objective.x.detach()[1]) == lower
