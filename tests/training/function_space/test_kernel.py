"""The linearisation without Jacobian against the Jacobian itself."""

from __future__ import annotations

import pytest
import torch
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.mlp import Mlp
from pinn_cli.physics import targets
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.function_space.collocation import collocate
from pinn_cli.training.function_space.kernel import prior_variance, pulled_back, pushed_forward
from pinn_cli.training.function_space.linearisation import Linearisation
from pinn_cli.training.function_space.residuals import ResidualRows
from pinn_cli.training.function_space.system import DenseSystem
from pinn_cli.training.learned_parameters import LearnedParameters

DESIGNS = {
    "fourier-sine": Mlp(1, 5, "sine", "exact", "fourier"),
    "time-tanh": Mlp(2, 6, "tanh", "penalised"),
    "fourier-silu": Mlp(3, 4, "silu", "penalised", "fourier"),
    "time-silu": Mlp(3, 5, "silu", "exact"),
}
CASES = [
    (name, through, hold)
    for name in DESIGNS
    for through, hold in (("derivative", "exact"), ("observer", "zero_order"), ("both", "exact"))
]


class Dense:
    """A small problem, its linearisation, and the dense Jacobian by reverse passes."""

    def __init__(self, design: str = "fourier-sine", through: str = "derivative", hold: str = "exact") -> None:
        structure = small_chain()
        record = accelerations(measured(structure, hold, snr_db=40.0).record, (1, 3))
        uncertain = tuple(
            Parameter(kind, dof, float(structure.parameters[kind][dof]), 0.1 * float(structure.parameters[kind][dof]))
            for kind, dof in (("m", 1), ("c", 0), ("k", 2), ("kappa", 1))
        )
        problem = Problem(structure, record, uncertain, through)
        self.network = DESIGNS[design].build(record)
        with torch.no_grad():
            for weight in self.network.weights:
                weight.mul_(1.5)
            # Dense least squares squares the condition of the Jacobian: keep readouts near one.
            last = self.network.weights[-1]
            last.mul_(1.0 / max(1.0, float(last.abs().max())))
        self.parameters = LearnedParameters(problem, torch.float64)
        self.parameters.moved.data += 0.05
        self.parameters.spread = 0.8
        collocation = collocate(problem, targets(problem.record, Dynamics(problem.structure)), 48, 10000)
        self.noise = collocation.noise_model(0.05, 0.01)
        self.rows = ResidualRows(problem.dynamics, collocation.target, through, self.network.continuity == "penalised")
        self.linear = Linearisation(self.network, self.parameters, self.rows, self.noise)

    def system(self, total: float) -> DenseSystem:
        return DenseSystem(self.linear.blocks, self.linear.by_parameter, total)

    def residuals(self) -> torch.Tensor:
        values, target = self.parameters(), self.rows.target
        observed = self.rows.observed(self.network(target.observation_time), values, self.noise)
        enforced = self.rows.enforced(self.network(target.physics_time), values, self.noise)
        return torch.cat((observed.flatten(), enforced.flatten()))

    def variables(self) -> list[torch.Tensor]:
        pairs = zip(self.network.weights, self.network.biases, strict=True)
        return [tensor for pair in pairs for tensor in pair]

    def jacobian(self) -> torch.Tensor:
        rows = []
        for residual in self.residuals():
            gradients = torch.autograd.grad(residual, self.variables(), retain_graph=True)
            rows.append(torch.cat([g.flatten() for g in gradients]))
        return torch.stack(rows)

    def flat(self, layers) -> torch.Tensor:
        return torch.cat([tensor.flatten() for layer in layers for tensor in layer])

    def layers(self, flat: torch.Tensor) -> list[tuple[torch.Tensor, torch.Tensor]]:
        pieces = flat.double().split([v.numel() for v in self.variables()])
        shaped = [piece.view(v.shape) for piece, v in zip(pieces, self.variables(), strict=True)]
        return list(zip(shaped[::2], shaped[1::2], strict=True))


@pytest.mark.parametrize(("design", "through", "hold"), CASES)
def test_the_kernel_is_that_of_the_jacobian(design, through, hold):
    dense = Dense(design, through, hold)
    jacobian = dense.jacobian()
    torch.testing.assert_close(dense.linear.residual, dense.residuals().detach())
    expected = jacobian @ jacobian.T
    limit = 1e-9 * float(expected.abs().max())
    torch.testing.assert_close(dense.linear.kernel.tril(), expected.tril(), rtol=1e-9, atol=limit)


@pytest.mark.parametrize("design", DESIGNS)
def test_products_with_the_jacobian_and_its_transpose(design):
    dense = Dense(design, "both")
    jacobian = dense.jacobian()
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(len(jacobian), generator=generator, dtype=torch.float64)
    direction = torch.randn(jacobian.shape[1], generator=generator, dtype=torch.float64)
    pieces = dense.linear._split(values)
    pulled = sum(dense.flat(pulled_back(b, v)) for b, v in zip(dense.linear.blocks, pieces, strict=True))
    torch.testing.assert_close(pulled, jacobian.T @ values)
    pushed = [pushed_forward(block, dense.layers(direction)).flatten() for block in dense.linear.blocks]
    torch.testing.assert_close(torch.cat(pushed), jacobian @ direction)


@pytest.mark.parametrize(("through", "hold"), [("derivative", "exact"), ("observer", "zero_order"), ("both", "exact")])
def test_derivatives_by_parameters(through, hold):
    dense = Dense("fourier-sine", through, hold)
    parameters = dense.parameters
    rows = [
        torch.autograd.grad(r, parameters.moved, retain_graph=True, allow_unused=True)[0] for r in dense.residuals()
    ]
    by_moved = torch.stack([torch.zeros_like(parameters.moved) if row is None else row for row in rows])
    expected = by_moved / parameters.unit * parameters.prior_deviation
    torch.testing.assert_close(dense.linear.by_parameter, expected.detach(), rtol=1e-8, atol=1e-8)


def test_a_step_solves_the_damped_least_squares():
    dense = Dense()
    jacobian, by_parameter = dense.jacobian(), dense.linear.by_parameter
    generator = torch.Generator().manual_seed(1)
    to_start = torch.randn(jacobian.shape[1], generator=generator, dtype=torch.float64)
    x = torch.randn(4, generator=generator, dtype=torch.float64)
    precision, damping = 3.0, 7.0
    step = dense.linear.step(dense.system(precision + damping), dense.layers(to_start), x, precision)
    # Least squares in (dw, x'), stacked: residuals, weights' prior, damping, parameters' prior.
    w, p = jacobian.shape[1], 4
    eye, none = torch.eye(w).double(), lambda *size: torch.zeros(*size).double()
    matrix = torch.cat(
        (
            torch.cat((jacobian, by_parameter), 1),
            torch.cat((precision**0.5 * eye, none(w, p)), 1),
            torch.cat((damping**0.5 * eye, none(w, p)), 1),
            torch.cat((none(p, w), torch.eye(p, dtype=torch.float64)), 1),
        )
    )
    target = torch.cat((by_parameter @ x - dense.linear.residual, precision**0.5 * to_start, none(w), none(p)))
    expected = torch.linalg.lstsq(matrix, target[:, None]).solution[:, 0]
    found = torch.cat((dense.flat(step.weights), step.parameters))
    # Directions that hardly matter are known to few digits; the sum of squares is known to many.
    least, reached = ((matrix @ x - target).square().sum() for x in (expected, found))
    torch.testing.assert_close(reached, least, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(found, expected, rtol=1e-2, atol=1e-4)


def test_what_is_kept_of_the_residuals_is_the_inverses_diagonal():
    dense = Dense()
    system = dense.system(2.0)
    whole = dense.linear.kernel.tril() + dense.linear.kernel.tril(-1).T
    whole = torch.eye(len(whole)).double() + whole / 2.0 + dense.linear.by_parameter @ dense.linear.by_parameter.T
    inverse = torch.linalg.inv(whole).diagonal()
    kept = system.kept(seed=0)
    assert float(kept.sum()) == pytest.approx(float(inverse.sum()), rel=0.1)
    torch.testing.assert_close(kept, system.kept(seed=0))


def test_the_variance_of_parameters_integrates_the_weights_out():
    dense = Dense()
    jacobian, by_parameter = dense.jacobian(), dense.linear.by_parameter
    precision = 2.0
    full = torch.cat((jacobian, by_parameter), 1)
    prior = torch.cat((precision * torch.ones(jacobian.shape[1]), torch.ones(4))).double()
    covariance = torch.linalg.inv(full.T @ full + torch.diag(prior))[-4:, -4:]
    found = dense.system(precision).parameter_covariance
    torch.testing.assert_close(found.diagonal(), covariance.diagonal(), rtol=1e-4, atol=1e-8)
    torch.testing.assert_close(found, covariance, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("design", DESIGNS)
def test_the_diagonal_of_the_kernel(design):
    dense = Dense(design, "both")
    diagonal = torch.cat([prior_variance(block).flatten() for block in dense.linear.blocks])
    torch.testing.assert_close(diagonal, dense.linear.kernel.diagonal())
