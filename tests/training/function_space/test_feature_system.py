"""Steps from the low-rank factor against those with the whole matrix."""

from collections.abc import Sequence
from dataclasses import dataclass

import pytest
import torch
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.mlp import Mlp
from pinn_cli.physics import targets
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.function_space import equations
from pinn_cli.training.function_space.collocation import collocate
from pinn_cli.training.function_space.equations import NetworkEquations
from pinn_cli.training.function_space.feature_system import (
    FeatureSystem,
    NotNearlyLinearError,
    coefficient_prior,
    follows_features,
)
from pinn_cli.training.function_space.network_frame import NetworkFrame
from pinn_cli.training.function_space.system import Block, DenseSystem
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.point import Point

DESIGNS = {
    "sine": Mlp(1, 12, "sine", "exact", "fourier"),
    "two layers of silu": Mlp(2, 12, "silu", "exact", "fourier"),
    "penalised": Mlp(1, 12, "tanh", "penalised", "fourier"),
}
PRECISION = 1e5


@dataclass
class Small:
    """A problem, its network at its start, and the linearisation there."""

    design: Mlp

    def __post_init__(self) -> None:
        structure = small_chain()
        record = accelerations(measured(structure, snr_db=40.0).record, (1, 3))
        uncertain = tuple(
            Parameter(kind, dof, float(structure.parameters[kind][dof]), 0.1 * float(structure.parameters[kind][dof]))
            for kind, dof in (("c", 0), ("k", 2), ("kappa", 1))
        )
        self.problem = Problem(structure, record, uncertain)
        collocation = collocate(self.problem, targets(record, self.problem.dynamics), 60, None)
        self.network = self.design.build(record, points=60)
        self.network.reset(0)
        self.network.make_nearly_linear()
        self.frame = NetworkFrame(self.network, self.problem, collocation.target)
        self.equations, noise = NetworkEquations(self.frame, PRECISION, 8000), collocation.noise_model(0.05, 0.01)
        self.point = self.equations.start()
        self.linear = self.equations.assemble(self.point, NoiseLevels((noise,))).linear

    def dense(self) -> DenseSystem:
        return DenseSystem(self.linear, PRECISION)

    def features(self, further: Sequence[Block] = ()) -> FeatureSystem:
        return FeatureSystem(self.linear, PRECISION, coefficient_prior(self.network, self.linear.time), further)

    def forces(self) -> Block:
        frame, some = self.frame, self.frame.at(self.linear.time[::7])

        def force(point: Point) -> torch.Tensor:
            jet = frame.jet(some, point)
            return torch.cat((jet.value, frame.dynamics.external_force(jet, frame.parameters(point))), -1)[0]

        return frame.linearised(some, self.point, force)[0]


@pytest.mark.parametrize("name", DESIGNS)
def test_a_step_is_that_of_the_whole_matrix(name):
    small = Small(DESIGNS[name])
    features, right = small.features(), small.linear.residual[:, None]
    expected = small.dense().solved(right)
    torch.testing.assert_close(features.solved(right), expected, rtol=1e-5, atol=1e-7 * float(expected.abs().max()))
    assert features.iterations < 40


def test_what_is_kept_is_what_the_whole_matrix_keeps():
    small = Small(DESIGNS["sine"])
    found, expected = small.features().kept(3), small.dense().kept(3)
    assert float(found.sum()) == pytest.approx(float(expected.sum()), rel=1e-2)


@pytest.mark.parametrize("name", DESIGNS)
def test_bands_are_those_of_the_whole_matrix(name):
    small = Small(DESIGNS[name])
    forces = small.forces()
    features, dense = small.features([forces]), small.dense()
    (known, following), (all_known, all_following) = features.explained(forces), dense.explained(forces)
    torch.testing.assert_close(known.sqrt(), all_known.sqrt(), rtol=0.01, atol=0.0)
    scale = float(all_following.abs().max())
    torch.testing.assert_close(following, all_following, rtol=0.01, atol=1e-3 * scale)
    torch.testing.assert_close(features.parameter_covariance, dense.parameter_covariance, rtol=0.01, atol=1e-4)
    assert abs(features.missed_unknowns()) < 0.01


@pytest.mark.slow
def test_units_that_bend_are_solved_with_the_whole_matrix(monkeypatch):
    monkeypatch.setattr(equations, "dense_operations", lambda blocks: float("inf"))
    monkeypatch.setattr("pinn_cli.training.function_space.feature_system.MOST_ITERATIONS", 1)
    small = Small(DESIGNS["sine"])
    estimate = GaussNewton().solve(JointProblem.of(small.problem), small.design, RunContext())
    assert estimate.summary["stop_reason"] == "converged"
    assert estimate.summary["solution"] == "dense"
    with pytest.raises(NotNearlyLinearError, match=r"training\.most_residuals"):
        GaussNewton(most_residuals=100).solve(JointProblem.of(small.problem), small.design, RunContext())


@pytest.mark.slow
def test_there_may_be_more_residuals_than_a_whole_matrix_has_room_for(monkeypatch):
    monkeypatch.setattr(equations, "dense_operations", lambda blocks: float("inf"))
    monkeypatch.setattr(equations, "DenseSystem", None)
    small = Small(DESIGNS["sine"])
    summary = (
        GaussNewton(most_residuals=100, iterations=2)
        .solve(JointProblem.of(small.problem), small.design, RunContext())
        .summary
    )
    assert summary["solution"] == "features"
    assert 5 * summary["collocation_points"] > 4 * 100  # two sensors, three equations of motion


def test_both_ways_find_the_same_motion(monkeypatch):
    small, found = Small(DESIGNS["sine"]), {}
    for way, dense in (("features", float("inf")), ("dense", 0.0)):
        monkeypatch.setattr(equations, "dense_operations", lambda blocks, value=dense: value)
        found[way] = GaussNewton().solve(JointProblem.of(small.problem), small.design, RunContext())
        assert found[way].summary["solution"] == way
    first, second = found.values()
    for quantity in ("displacement", "acceleration"):
        values = [torch.as_tensor(getattr(each.response, quantity)) for each in (first, second)]
        torch.testing.assert_close(values[0], values[1], rtol=0.0, atol=1e-4 * float(values[1].abs().max()))
        bands = [torch.as_tensor(getattr(each.std, quantity)) for each in (first, second)]
        torch.testing.assert_close(bands[0], bands[1], rtol=0.02, atol=0.0)
    for one, other in zip(first.parameters, second.parameters, strict=True):
        assert one.std == pytest.approx(other.std, rel=0.01)


@pytest.mark.parametrize(
    ("design", "follows"),
    [(Mlp(1, 12, "sine", "exact", "fourier"), True), (Mlp(1, 2, "sine", "exact", "fourier"), False),
     (Mlp(1, 5, "sine", "penalised", "fourier"), False), (Mlp(2, 12, "sine", "exact"), False)],
)  # fmt: skip
def test_only_embedded_networks_of_enough_units_follow_features(design, follows):
    assert follows_features(design.build(measured(small_chain()).record)) is follows
