"""Loss weights that are found rather than given."""

import math

import numpy as np
import pytest
import torch
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.mlp import Mlp
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.losses import Losses
from pinn_cli.training.gradient.objective import Objective
from pinn_cli.training.learned_parameters import LearnedParameters


def objective() -> Objective:
    structure = small_chain()
    record = accelerations(measured(structure, snr_db=40.0).record)
    problem = Problem(structure, record)
    network = Mlp(1, 16, "sine").build(record)
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


def test_equalised_weights_are_frozen_but_for_the_growth_of_the_physics():
    given = objective()
    given.begin_stage(0, 1.0)
    first = given().weights
    with torch.no_grad():
        for variable in given.variables:
            variable.mul_(0.5)
    given.begin_stage(1, 10.0)
    second = given().weights
    assert second["observation"] == first["observation"]
    assert second["continuity"] == first["continuity"]
    assert second["forced"] == pytest.approx(10.0 * first["forced"])


def test_the_history_has_the_weights_that_were_found():
    structure = small_chain()
    problem = Problem(structure, accelerations(measured(structure, snr_db=40.0).record))
    training = Adam(iterations=10, stages=2, weights="equalised", collocation_points=128, history_every=5)
    history = training.solve(JointProblem.of(problem), Mlp(1, 16, "sine"), RunContext()).history
    assert history["iteration"].tolist() == [0, 5, 10, 15, 20]
    # The row at the border of two stages has the second one's weights.
    expected = history["weight_unforced"][0] * np.array([1.0, 1.0, 10.0, 10.0, 10.0])
    np.testing.assert_allclose(history["weight_unforced"], expected)
