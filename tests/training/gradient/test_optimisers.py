"""Every optimiser on a small problem: it solves it, and goes on from its state without a trace."""

import numpy as np
import pytest
import torch
from calls import SMALL, Compose
from small_problems import QUANTITIES, accelerations, measured, relative_error, small_chain

from pinn_cli.cli.config import RunConfig
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.mlp import Mlp
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.lbfgs import Lbfgs

TRAININGS = {"adam": Adam, "lbfgs": Lbfgs}
NETWORK = Mlp(1, 12, "sine", "exact")


def small_problem() -> Problem:
    structure = small_chain()
    stiffness = Parameter("k", 1, 15.0, 1.5)
    return Problem(structure, accelerations(measured(structure, snr_db=40.0).record), (stiffness,))


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
