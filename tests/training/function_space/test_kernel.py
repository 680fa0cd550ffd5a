"""The linearisation without Jacobian against the Jacobian itself."""

from functools import cached_property

import numpy as np
import pytest
import torch
from small_problems import accelerations, believed, measured, small_chain

from pinn_cli.network.mlp import Mlp
from pinn_cli.physics import observation_residuals, physics_residual, targets
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.training.function_space.equations import NetworkEquations
from pinn_cli.training.function_space.network_frame import NetworkFrame
from pinn_cli.training.function_space.system import DenseSystem, pull, push
from pinn_cli.training.function_space.training import collocate
from pinn_cli.training.minimise import FIRST_DAMPING, Point
from pinn_cli.training.noise_model import NoiseLevels

PRECISION = 3.0
DESIGNS = {
    "fourier-sine": Mlp(1, 5, "sine", "exact", "fourier"),
    "time-tanh": Mlp(2, 6, "tanh", "penalised"),
    "fourier-silu": Mlp(3, 4, "silu", "penalised", "fourier"),
    "time-silu": Mlp(3, 5, "silu", "exact"),
}
CASES = [
    ("fourier-sine", "both", "exact"),
    ("time-tanh", "both", "exact"),
    *(pytest.param(name, "both", "exact", marks=pytest.mark.slow) for name in ("fourier-silu", "time-silu")),
    ("fourier-sine", "derivative", "exact"),
    ("fourier-sine", "observer", "zero_order"),
]


class Dense:
    """A small problem, its linearisation, and the dense Jacobian by reverse passes."""

    def __init__(self, design: str = "fourier-sine", through: str = "derivative", hold: str = "exact") -> None:
        structure = small_chain()
        record = accelerations(measured(structure, hold, snr_db=40.0).record, (1, 3))
        uncertain = believed(structure, ("m", 1), ("c", 0), ("k", 2), ("kappa", 1))
        problem = Problem(structure, record, uncertain, through)
        network = DESIGNS[design].build(record)
        with torch.no_grad():
            for weight in network.weights:
                weight.mul_(1.5)
            # Dense least squares squares the condition of the Jacobian: keep readouts near one.
            last = network.weights[-1]
            last.mul_(1.0 / max(1.0, float(last.abs().max())))
        collocation = collocate(problem, targets(problem.record, Dynamics(problem.structure)), 48, 10000)
        self.noise = NoiseLevels((collocation.noise_model(0.05, 0.01),), 0.8)
        self.frame = NetworkFrame(network, problem, collocation.target)
        self.equations = NetworkEquations(self.frame, PRECISION, 10000)
        generator = torch.Generator().manual_seed(1)
        apart = 0.01 * torch.randn(len(self.frame.weights), generator=generator, dtype=torch.float64)
        self.point = Point(self.frame.weights + apart, torch.linspace(-0.5, 0.5, 4, dtype=torch.float64))
        self.system = self.equations.assemble(self.point, self.noise)
        self.linear = self.system.linear
        size = [block.points for block in self.linear.blocks for _ in range(block.rows)]
        self.kernel = torch.zeros(sum(size), sum(size), dtype=torch.float64)
        ends = np.cumsum([0, *size])
        for (i, j), product in self.linear.kernel.items():
            self.kernel[ends[i] : ends[i + 1], ends[j] : ends[j + 1]] = product
            self.kernel[ends[j] : ends[j + 1], ends[i] : ends[i + 1]] = product.T

    def residuals(self, weights: torch.Tensor, parameters: torch.Tensor) -> torch.Tensor:
        """Of the factors over their noise, from the network's own motion."""
        frame, network = self.frame, self.frame.perceptron
        names = [name for name, _ in network.named_parameters()]
        shaped = weights.split([p.numel() for p in network.parameters()])
        given = {n: x.view(p.shape) for n, x, p in zip(names, shaped, network.parameters(), strict=True)}
        values = frame.vector.values(frame.scale * self.system.unit * parameters)
        seen, felt = (
            torch.func.functional_call(network, given, (time,))
            for time in (frame.target.observation_time, frame.target.physics_time)
        )
        model, through = self.noise.records[0], frame.problem.acceleration_through
        mass = frame.prescribed["m"].numpy()
        rows = []
        for name, residual in observation_residuals(seen, frame.target, frame.dynamics, values, through).items():
            weight = torch.as_tensor(model.observer_weight(mass) if name == "observer" else model.sensor_weight(name))
            rows.append((residual * weight.sqrt())[:, weight > 0].T.flatten())
        force = physics_residual(felt, frame.target, frame.dynamics, values)
        rows.append((force / torch.as_tensor(model.physics_variance).sqrt()).T.flatten())
        if felt.continuity is not None:
            rows.append(felt.continuity.T.flatten() / model.continuity)
        return torch.cat(rows)

    @cached_property
    def jacobians(self) -> tuple[torch.Tensor, torch.Tensor]:
        """By the weights, and by the parameters in their deviations."""
        at = self.point.unknowns, self.point.parameters / self.system.unit
        by_weights, by_parameters = torch.autograd.functional.jacobian(self.residuals, at)
        return by_weights, by_parameters


@pytest.mark.parametrize(("design", "through", "hold"), CASES)
def test_the_linearisation_is_that_of_the_jacobian(design, through, hold):
    dense = Dense(design, through, hold)
    by_weights, by_parameters = dense.jacobians
    torch.testing.assert_close(dense.linear.residual, dense.residuals(dense.point.unknowns, dense.system.parameters))
    torch.testing.assert_close(dense.linear.by_parameter, by_parameters, rtol=1e-8, atol=1e-8)
    expected = by_weights @ by_weights.T
    torch.testing.assert_close(dense.kernel, expected, rtol=1e-9, atol=1e-9 * float(expected.abs().max()))
    diagonal = torch.cat([block.variance.flatten() for block in dense.linear.blocks])
    torch.testing.assert_close(diagonal, dense.kernel.diagonal())
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(len(by_weights), generator=generator, dtype=torch.float64)
    direction = torch.randn(by_weights.shape[1], generator=generator, dtype=torch.float64)
    pulled = dense.frame.flat(pull(dense.linear.blocks, values[:, None]))
    torch.testing.assert_close(pulled, by_weights.T @ values)
    pushed = push(dense.linear.blocks, dense.frame.layers(direction))[:, 0]
    torch.testing.assert_close(pushed, by_weights @ direction)


def test_a_step_solves_the_damped_least_squares():
    dense = Dense()
    jacobian, by_parameter = dense.jacobians
    to_start, x = dense.equations.origin - dense.point.unknowns, dense.system.parameters
    damping = 7.0
    solved = dense.system.factor(damping / PRECISION * FIRST_DAMPING)
    # Least squares in (dw, x'), stacked: residuals, weights' prior, damping, parameters' prior.
    w, p = jacobian.shape[1], 4
    eye, none = torch.eye(w).double(), lambda *size: torch.zeros(*size).double()
    matrix = torch.cat(
        (
            torch.cat((jacobian, by_parameter), 1),
            torch.cat((PRECISION**0.5 * eye, none(w, p)), 1),
            torch.cat((damping**0.5 * eye, none(w, p)), 1),
            torch.cat((none(p, w), torch.eye(p, dtype=torch.float64)), 1),
        )
    )
    target = torch.cat((by_parameter @ x - dense.linear.residual, PRECISION**0.5 * to_start, none(w), none(p)))
    expected = torch.linalg.lstsq(matrix, target[:, None]).solution[:, 0]
    weights, parameters = solved.way
    found = torch.cat((weights, x + torch.as_tensor(parameters) / dense.system.unit))
    # Directions that hardly matter are known to few digits; the sum of squares is known to many.
    least, reached = ((matrix @ x - target).square().sum() for x in (expected, found))
    torch.testing.assert_close(reached, least, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(found, expected, rtol=1e-2, atol=1e-4)


def test_a_whole_step_promises_what_the_linearised_loss_loses():
    dense = Dense()
    solved = dense.system.factor(0.0)
    weights, parameters = solved.way
    jacobian, by_parameter = dense.jacobians
    moved = torch.as_tensor(parameters) / dense.system.unit
    residual = dense.linear.residual + jacobian @ weights + by_parameter @ moved
    torch.testing.assert_close(residual, solved.residual, rtol=0.0, atol=1e-2 * float(residual.abs().max()))
    loss = residual.square().sum() + (dense.system.parameters + moved).square().sum()
    loss += PRECISION * (dense.point.unknowns + weights - dense.equations.origin).square().sum()
    before = sum(dense.equations.losses(dense.point, dense.noise).values())
    assert dense.system.decrease(solved.way) == pytest.approx(before - float(loss), rel=1e-6)


def test_what_is_kept_of_the_residuals_is_the_inverses_diagonal():
    dense = Dense()
    system = DenseSystem(dense.linear, 2.0)
    by_parameter = dense.linear.by_parameter
    whole = torch.eye(len(dense.kernel)).double() + dense.kernel / 2.0 + by_parameter @ by_parameter.T
    inverse = torch.linalg.inv(whole).diagonal()
    kept = system.kept(seed=0)
    assert float(kept.sum()) == pytest.approx(float(inverse.sum()), rel=0.1)
    torch.testing.assert_close(kept, system.kept(seed=0))


def test_the_variance_of_parameters_integrates_the_weights_out():
    dense = Dense()
    full = torch.cat(dense.jacobians, 1)
    prior = torch.cat((PRECISION * torch.ones(full.shape[1] - 4), torch.ones(4))).double()
    covariance = torch.linalg.inv(full.T @ full + torch.diag(prior))[-4:, -4:]
    found = DenseSystem(dense.linear, PRECISION).parameter_covariance
    torch.testing.assert_close(found.diagonal(), covariance.diagonal(), rtol=1e-4, atol=1e-8)
    torch.testing.assert_close(found, covariance, rtol=1e-3, atol=1e-6)
