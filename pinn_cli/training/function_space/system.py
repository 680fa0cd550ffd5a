"""The linear system of a Gauss-Newton step in the space of the residuals, and what is known once it is solved.

The residuals of a multilayer perceptron linearised in all its weights, without their Jacobian.

Residual r depends on the weights W_l of layer l through z_l^q = W_l a_l^q, where q counts value, first and second time
derivative, and a_l^q is what the layer gets, with a constant for the bias. So dr/dW_l is the sum over q of
d_l^q (x) a_l^q, with d_l^q = dr/dz_l^q, and

    J J' = sum over l, q, p of (d_l^q . d_l^p) (a_l^q . a_l^p)

elementwise in pairs of residuals: products of narrow matrices, however many weights there are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from pinn_cli.network.activation import ACTIVATIONS, propagate
from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.network.network import States
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.block_cholesky import BlockCholesky, BlockPattern, Blocks

# Random signs that estimate how many residuals each group keeps; their scatter is a few in a thousand residuals.
TRACE_PROBES = 16


@dataclass(frozen=True, eq=False)
class Layer:
    """Residuals of R rows at P times by the weights between what a layer gets and what it, or a later one, gives.

    Attributes:
        inputs: (Q, P, I), what it gets and its time derivatives; last the constant that a bias stands on.
        sensitivity: (P, R, Q, O), derivative of residual (row, point) by what is given.
    """

    inputs: Tensor
    sensitivity: Tensor

    def forward(self, weights: Tensor) -> Tensor:
        """(R P, k), by a change (O, I, k) of the weights."""
        points, _, derivatives, outputs = self.sensitivity.shape
        count = weights.shape[2]
        flat = weights.movedim(1, 0).reshape(-1, outputs * count)
        given = (self.inputs @ flat).movedim(1, 0).reshape(points, derivatives * outputs, count)
        return (self.sensitivity.flatten(2) @ given).movedim(1, 0).reshape(-1, count)

    def backward(self, values: Tensor) -> Tensor:
        """(O, I, k), the transposed times (R P, k)."""
        points, rows, derivatives, outputs = self.sensitivity.shape
        count = values.shape[1]
        by_point = values.view(rows, points, count).movedim(1, 0)
        given = (self.sensitivity.flatten(2).mT @ by_point).view(points, derivatives, outputs * count).movedim(1, 0)
        flat = self.inputs.flatten(0, 1).T @ given.reshape(derivatives * points, outputs * count)
        return flat.view(-1, outputs, count).movedim(1, 0)

    @cached_property
    def active(self) -> list[list[set[int]]]:
        """By row and derivative, the units that it depends on anywhere: of the outputs an equation looks at three."""
        nonzero = self.sensitivity.ne(0).any(0).cpu()
        return [[set(units.nonzero()[:, 0].tolist()) for units in row] for row in nonzero]


@dataclass(frozen=True, eq=False)
class Block:
    """The residuals that look at the motion at the same P times, by the weights of every layer."""

    layers: list[Layer]

    @property
    def points(self) -> int:
        """P."""
        return self.layers[0].sensitivity.shape[0]

    @property
    def rows(self) -> int:
        """R."""
        return self.layers[0].sensitivity.shape[1]

    @property
    def size(self) -> int:
        """R P."""
        return self.points * self.rows

    @property
    def linear(self) -> Block:
        """By the combinations of the features that outputs are where hidden units are linear."""
        return Block([Layer(self.layers[0].inputs, self.layers[-1].sensitivity)])

    @property
    def outputs(self) -> list[list[int]]:
        """By row, those that it depends on anywhere."""
        return [sorted(set().union(*row)) for row in self.layers[-1].active]

    @property
    def variance(self) -> Tensor:
        """(R, P), the diagonal of the kernel of the block with itself."""
        by_layer = (
            torch.einsum("prqo,prso,qsp->rp", d, d, torch.einsum("qpi,spi->qsp", a, a))
            for a, d in ((layer.inputs, layer.sensitivity) for layer in self.layers)
        )
        return reduce(torch.add, by_layer)


def pull(blocks: Sequence[Block], values: Tensor) -> list[Tensor]:
    """J' times (M, k): by layer (O, I, k)."""
    pieces = values.split([block.size for block in blocks])
    by_block = [[layer.backward(piece) for layer in block.layers] for block, piece in zip(blocks, pieces, strict=True)]
    return [reduce(torch.add, layer) for layer in zip(*by_block, strict=True)]


def push(blocks: Sequence[Block], weights: Sequence[Tensor]) -> Tensor:
    """J times changes of the weights of every layer, (O, I, k): (M, k)."""
    by_layer = ((layer.forward(w) for layer, w in zip(block.layers, weights, strict=True)) for block in blocks)
    return torch.cat([reduce(torch.add, of_block) for of_block in by_layer])


def forward(network: MlpNetwork, time: Tensor) -> tuple[list[Tensor], list[Tensor], States]:
    """What every layer gets, with a constant, what it gives, (Q, P, width) each and with a graph, and the motion."""
    order, activation = network.order, ACTIVATIONS[network.activation]
    arriving = torch.stack(network.input_jet(time, order))
    constant = functional.pad(torch.ones_like(arriving[:1, :, :1]), (0, 0, 0, 0, 0, order))
    inputs, outputs = [], []
    for weight, bias in zip(network.weights, network.biases, strict=True):
        inputs.append(torch.cat((arriving.detach(), constant), 2))
        given = functional.linear(arriving, weight.detach().requires_grad_())
        outputs.append(given + functional.pad(bias.detach()[None, None], (0, 0, 0, 0, 0, order)))
        arriving = torch.stack(propagate(activation, tuple(outputs[-1].unbind())))
    jet = tuple(network.amplitude / network.span**q * x for q, x in enumerate(outputs[-1].unbind()))
    return inputs, outputs, network.states(jet)


def block_of(inputs: Sequence[Tensor], outputs: Sequence[Tensor], residuals: Tensor) -> Block:
    """The linearisation of residuals (P, R), each of which depends on the outputs at its own time only."""
    gradients = [torch.autograd.grad(row.sum(), list(outputs), retain_graph=True) for row in residuals.unbind(1)]
    sensitivity = (torch.stack([g.movedim(1, 0) for g in layer], 1) for layer in zip(*gradients, strict=True))
    return Block([Layer(a, d) for a, d in zip(inputs, sensitivity, strict=True)])


class RowPairs:
    """The kernel of the rows of two blocks, one pair after the other, which fits a cache."""

    def __init__(self, here: Block, there: Block) -> None:
        self.layers = list(zip(here.layers, there.layers, strict=True))
        self.products = [[[a @ b.T for b in right.inputs] for a in left.inputs] for left, right in self.layers]
        self.shape = (here.points, there.points)

    def __call__(self, row: int, other: int) -> Tensor:
        """(P_here, P_there)."""
        total = self.products[0][0][0].new_zeros(self.shape)
        for (left, right), products in zip(self.layers, self.products, strict=True):
            for q, by_derivative in enumerate(products):
                for p, product in enumerate(by_derivative):
                    common = left.active[row][q] & right.active[other][p]
                    if common:
                        is_all = len(common) == left.sensitivity.shape[3]
                        units = slice(None) if is_all else sorted(common)
                        by_left, by_right = left.sensitivity[:, row, q, units], right.sensitivity[:, other, p, units]
                        total.addcmul_(by_left @ by_right.T, product)
        return total


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals r + J dw + J_p dx about the present weights and parameters, each over its noise.

    Attributes:
        blocks: J.
        residual: r, (M,).
        by_parameter: J_p, (M, p), by the parameters in prior standard deviations.
        time: (P,), s, of the equations of motion.
    """

    blocks: list[Block]
    residual: Tensor
    by_parameter: Tensor
    time: Tensor

    @cached_property
    def kernel(self) -> Blocks:
        """J J', its lower triangle: a block for every pair of rows."""
        out: Blocks = {}
        starts = np.cumsum([0, *(block.rows for block in self.blocks)]).tolist()
        for i, here in enumerate(self.blocks):
            for j, there in enumerate(self.blocks[: i + 1]):
                pairs = RowPairs(here, there)
                for row in range(here.rows):
                    for other in range(row + 1 if i == j else there.rows):
                        out[starts[i] + row, starts[j] + other] = pairs(row, other)
        return out


class System(ABC):
    """I + J J' / total + J_p J_p': M residuals by weights of precision ``total`` and by parameters of unit variance.

    Args:
        linear: The residuals.
        total: Precision of the weights, damping included.
    """

    def __init__(self, linear: Linearised, total: float) -> None:
        self.blocks, self.by_parameter, self.total = linear.blocks, linear.by_parameter, total

    @abstractmethod
    def solved(self, right: Tensor) -> Tensor:
        """The inverse times (M, k)."""

    @abstractmethod
    def without_parameters(self, right: Tensor) -> Tensor:
        """The inverse of the system without its parameters times (M, k)."""

    @abstractmethod
    def explained(self, block: Block) -> tuple[Tensor, Tensor]:
        """What the residuals tell about other quantities of the network.

        Args:
            block: Q quantities (R, P).

        Returns:
            Their variance with the parameters known, (Q,), and minus their derivatives by the parameters, (Q, p): the
            network follows the parameters as it follows the residuals.
        """

    def probed(self, signs: Tensor) -> Tensor:
        """The inverse times random signs (M, k), as exactly as their own scatter asks for."""
        return self.solved(signs)

    def kept(self, seed: int) -> Tensor:
        """(M,) diagonal of the inverse: how much of each residual the fit leaves free, from 0 to 1.

        N minus the effective number of unknowns gamma of a group (MacKay 1992) is the sum over its residuals. By
        Hutchinson's probes, so single values scatter; sums over hundreds do not.
        """
        signs = probes(self.by_parameter, seed)
        return (signs * self.probed(signs)).mean(1)

    @cached_property
    def parameter_covariance(self) -> Tensor:
        """(p, p), of the parameters in prior standard deviations, weights integrated out."""
        eye = torch.eye(self.by_parameter.shape[1]).to(self.by_parameter)
        return torch.linalg.inv(eye + self.by_parameter.T @ self._by_parameter_solved)

    @cached_property
    def _by_parameter_solved(self) -> Tensor:
        return self.without_parameters(self.by_parameter)

    def with_parameters(self, right: Tensor) -> Tensor:
        """The inverse times (M, k) from that of the system without its parameters (Woodbury)."""
        solved = self.without_parameters(right)
        return solved - self._by_parameter_solved @ (self.parameter_covariance @ (self.by_parameter.T @ solved))


def probes(like: Tensor, seed: int) -> Tensor:
    """(M, ``TRACE_PROBES``) random signs, the same on every device."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 2, (len(like), TRACE_PROBES), generator=generator).to(like) * 2.0 - 1.0


class DenseSystem(System):
    """Of any network, by the Cholesky factor of the whole matrix.

    Raises:
        DivergenceError: The system is singular in double precision.
    """

    def __init__(self, linear: Linearised, total: float) -> None:
        super().__init__(linear, total)
        self.heights = [block.points for block in self.blocks for _ in range(block.rows)]
        blocks = {place: block / total for place, block in linear.kernel.items()}
        for row in range(len(self.heights)):
            blocks[row, row].diagonal().add_(1.0)
        try:
            self.factor = BlockCholesky(BlockPattern(np.ones((len(self.heights),) * 2, dtype=bool)), blocks)
        except FloatingPointError as error:
            raise DivergenceError(
                "gauss_newton diverged: its normal matrix is singular; try network.width or training.collocation_points"
                " of half the size"
            ) from error

    def solved(self, right: Tensor) -> Tensor:
        """See :meth:`System.solved`."""
        return self.with_parameters(right)

    def without_parameters(self, right: Tensor) -> Tensor:
        """See :meth:`System.without_parameters`."""
        return torch.cat(self.factor.solved(list(right.split(self.heights))))

    def explained(self, block: Block) -> tuple[Tensor, Tensor]:
        """See :meth:`System.explained`."""
        across = torch.cat([_cross_kernel(rows, block) for rows in self.blocks]) / self.total
        half = torch.cat(self.factor.forward(list(across.split(self.heights))))
        by_parameter = torch.cat(self.factor.forward(list(self.by_parameter.split(self.heights))))
        return block.variance.flatten() / self.total - half.square().sum(0), half.T @ by_parameter


def _cross_kernel(here: Block, there: Block) -> Tensor:
    """J_here J_there', (M_here, M_there)."""
    pairs = RowPairs(here, there)
    return torch.cat([torch.cat([pairs(i, j) for j in range(there.rows)], 1) for i in range(here.rows)])


def dense_operations(blocks: Sequence[Block]) -> float:
    """Multiplications and additions of a step with the whole matrix."""
    residuals = sum(block.size for block in blocks)
    units = sum(layer.sensitivity.shape[3] for layer in blocks[0].layers[:-1])
    derivatives = len(blocks[0].layers[0].inputs)
    return float(residuals) ** 2 * (derivatives**2 * units + residuals / 3.0 + 2.0 * TRACE_PROBES)
