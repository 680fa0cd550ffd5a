"""Steps from the low-rank factor against those with the whole matrix; conjugate gradients and Cholesky by blocks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from small_problems import accelerations, believed, measured, small_chain

from pinn_cli.network.mlp import Mlp
from pinn_cli.physics import targets
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.function_space import equations
from pinn_cli.training.function_space.block_cholesky import BlockCholesky, BlockPattern, Blocks, entry
from pinn_cli.training.function_space.equations import NetworkEquations
from pinn_cli.training.function_space.feature_system import (
    FeatureSystem,
    NotNearlyLinearError,
    coefficient_prior,
    conjugate_gradients,
    follows_features,
)
from pinn_cli.training.function_space.network_frame import NetworkFrame
from pinn_cli.training.function_space.system import Block, DenseSystem
from pinn_cli.training.function_space.training import collocate
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels

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
        self.problem = Problem(structure, record, believed(structure, ("c", 0), ("k", 2), ("kappa", 1)))
        collocation = collocate(self.problem, targets(record, self.problem.dynamics), 60, None)
        self.network = self.design.build(record, points=60)
        self.network.reset(0)
        self.network.make_nearly_linear()
        self.frame = NetworkFrame(self.network, self.problem, collocation.target)
        self.equations, noise = NetworkEquations(self.frame, PRECISION, 8000), collocation.noise_model(0.05, 0.01)
        self.point = self.equations.start()
        self.linear = self.equations.assemble(self.point, NoiseLevels((noise,))).linear

    def solved(self, **settings) -> Estimate:
        return GaussNewton(**settings).solve(JointProblem.of(self.problem), self.design, RunContext())

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
    summary = small.solved().summary
    assert summary["stop_reason"] == "converged"
    assert summary["solution"] == "dense"
    with pytest.raises(NotNearlyLinearError, match=r"training\.most_residuals"):
        small.solved(most_residuals=100)


@pytest.mark.slow
def test_there_may_be_more_residuals_than_a_whole_matrix_has_room_for(monkeypatch):
    monkeypatch.setattr(equations, "dense_operations", lambda blocks: float("inf"))
    monkeypatch.setattr(equations, "DenseSystem", None)
    summary = Small(DESIGNS["sine"]).solved(most_residuals=100, iterations=2).summary
    assert summary["solution"] == "features"
    assert 5 * summary["collocation_points"] > 4 * 100  # two sensors, three equations of motion


def test_both_ways_find_the_same_motion(monkeypatch):
    small, found = Small(DESIGNS["sine"]), {}
    for way, dense in (("features", float("inf")), ("dense", 0.0)):
        monkeypatch.setattr(equations, "dense_operations", lambda blocks, value=dense: value)
        found[way] = small.solved()
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


def system(size: int = 60, off: float = 1.0) -> torch.Tensor:
    """Of a condition of a million; eigenvalues are ``off`` by a factor that grows along them."""
    generator = torch.Generator().manual_seed(0)
    basis, _ = torch.linalg.qr(torch.randn(size, size, generator=generator, dtype=torch.float64))
    values = torch.logspace(0.0, 6.0, size, dtype=torch.float64) * torch.linspace(1.0, off, size, dtype=torch.float64)
    return (basis * values) @ basis.T


def right(size: int = 60) -> torch.Tensor:
    columns = torch.randn(size, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    columns[:, 1] = 0.0  # one that is solved before it begins
    return columns


def test_a_good_preconditioner_makes_few_iterations():
    matrix = system()
    rough = torch.linalg.inv(system(off=3.0))
    found, iterations, reached = conjugate_gradients(matrix.matmul, rough.matmul, right(), 1e-10, 60)
    torch.testing.assert_close(found, torch.linalg.solve(matrix, right()), rtol=1e-5, atol=1e-8)
    assert iterations < 30
    assert reached <= 1e-10


def test_it_says_how_far_it_got():
    matrix = system()
    _, iterations, reached = conjugate_gradients(matrix.matmul, lambda x: x, right(), 1e-10, 5)
    assert iterations == 5
    assert reached > 1e-3


def test_the_exact_inverse_takes_one_iteration():
    matrix = system()
    found, iterations, _ = conjugate_gradients(matrix.matmul, torch.linalg.inv(matrix).matmul, right(), 1e-6, 60)
    assert iterations == 1
    torch.testing.assert_close(matrix @ found, right(), rtol=1e-5, atol=1e-5)


# Block rows of unequal heights: of every row of the matrix the block row.
HEIGHTS = [4, 3, 5, 4, 1]
OF = torch.arange(5).repeat_interleave(torch.tensor(HEIGHTS))
# A chain, one whose ends meet, a star and a tree, and blocks that do not know each other.
COUPLINGS = {
    "chain": [(0, 1), (1, 2), (2, 3), (3, 4)],
    "ring": [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)],
    "star": [(0, 1), (0, 2), (0, 3), (0, 4)],
    "apart": [(0, 3)],
    "whole": [(i, j) for i in range(5) for j in range(i)],
}


def coupled(name: str) -> np.ndarray:
    out = np.eye(5, dtype=bool)
    for i, j in COUPLINGS[name]:
        out[i, j] = out[j, i] = True
    return out


def matrix_and_blocks(name: str) -> tuple[torch.Tensor, BlockPattern, Blocks]:
    pattern = BlockPattern(coupled(name))
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(len(OF), len(OF), generator=generator, dtype=torch.float64)
    mask = torch.as_tensor(coupled(name))[OF][:, OF]
    matrix = (noise + noise.T) * mask
    matrix += 20.0 * torch.eye(len(matrix))
    there = zip(*np.nonzero(np.tril(coupled(name))), strict=True)
    return matrix, pattern, {(int(i), int(j)): matrix[i == OF][:, j == OF].clone() for i, j in there}


@pytest.mark.parametrize("name", COUPLINGS)
def test_it_solves_what_dense_algebra_solves(name):
    matrix, pattern, blocks = matrix_and_blocks(name)
    factor = BlockCholesky(pattern, blocks)
    right = torch.randn(len(OF), 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    expected = torch.linalg.solve(matrix, right)
    torch.testing.assert_close(torch.cat(factor.solved(list(right.split(HEIGHTS)))), expected)
    half = torch.cat(factor.forward(list(right.split(HEIGHTS))))
    torch.testing.assert_close(half.T @ half, right.T @ expected)


@pytest.mark.parametrize("name", COUPLINGS)
def test_the_blocks_of_the_inverse(name):
    matrix, pattern, blocks = matrix_and_blocks(name)
    found = BlockCholesky(pattern, blocks).inverse
    inverse = torch.linalg.inv(matrix)
    for i, j in zip(*np.nonzero(coupled(name)), strict=True):
        expected = inverse[i == OF][:, j == OF]
        torch.testing.assert_close(entry(found, i, j), expected)


def test_a_chain_and_a_star_fill_nothing_in():
    assert [len(later) for later in BlockPattern(coupled("chain")).below] == [1, 1, 1, 1, 0]
    assert sum(len(later) for later in BlockPattern(coupled("star")).below) == 4
    assert BlockPattern(coupled("chain")).operations < 0.5 * BlockPattern(coupled("whole")).operations


def test_the_whole_matrix_takes_a_third_of_its_cube():
    dense = BlockPattern(np.ones((12, 12), dtype=bool)).operations
    assert dense == pytest.approx(12**3 / 3, rel=0.15)


def test_what_is_not_positive_definite_is_refused():
    _, pattern, blocks = matrix_and_blocks("chain")
    blocks[2, 2] -= 100.0 * torch.eye(HEIGHTS[2])
    with pytest.raises(FloatingPointError):
        BlockCholesky(pattern, blocks)
