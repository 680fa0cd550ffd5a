"""The system of a step where hidden units are nearly linear: a low-rank factor, and conjugate gradients from it.

As long as what the hidden units get hardly changes their slopes, a change of any weights moves the outputs by as many
combinations C of the embedding's features as there are outputs. The kernel is then that of C alone: of low rank, and
coupled between outputs only where an equation of motion couples them. Its factor costs a small part of that of the
whole kernel, and preconditions conjugate gradients on the whole one, whose products need no kernel at all. Bands come
from the factor: the linear model of the units, which is the better the smaller their first weights are
(:data:`pinn_cli.network.mlp.LINEAR_GAIN`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import reduce

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.block_cholesky import BlockCholesky, BlockPattern, Blocks, entry
from pinn_cli.training.function_space.system import TRACE_PROBES, Block, Linearised, System, probes, pull, push

Operator = Callable[[Tensor], Tensor]
"""From (M, k) to (M, k), symmetric and positive definite."""
# Of the residual in conjugate gradients, over the right-hand side, in the preconditioner's norm. A step's: with 1e-5
# the motion that is left bends the units and trainings take twice as many steps; rounding may keep it above that, and
# beyond the second it is no solution. That of probes, whose own scatter is larger.
STEP_TOLERANCE, LEAST_TOLERANCE, PROBE_TOLERANCE = 1e-8, 1e-5, 1e-2
MOST_ITERATIONS = 150
# Iterations that conjugate gradients take, as counted on chains of 6 to 50 DOFs: of a step, and of its probes.
USUAL_ITERATIONS, USUAL_PROBE_ITERATIONS = 12, 3


def conjugate_gradients(
    apply: Operator, precondition: Operator, right: Tensor, tolerance: float, most: int
) -> tuple[Tensor, int, float]:
    """Solve ``apply(x) = right``, every column for itself (Golub and Van Loan 2013, section 11.5.2).

    Args:
        apply: The system's matrix.
        precondition: Roughly its inverse.
        right: (M, k).
        tolerance: Residual in the preconditioner's norm, over that of the right-hand side, at which a column is solved.
        most: Iterations at most.

    Returns:
        The solution (M, k), how many iterations it took, and the residual of the column that is solved worst.
    """
    out, residual = torch.zeros_like(right), right.clone()
    way = precondition(residual)
    size = (residual * way).sum(0)
    begun, least, ones = size, tolerance**2 * size, torch.ones_like(size)
    direction, iterations = way, 0
    while iterations < most:
        going = size > least
        if not bool(going.any()):
            break
        iterations += 1
        image = apply(direction)
        curvature = (direction * image).sum(0)
        # A column that is solved to the last digit has no direction left.
        going &= curvature > 0.0
        length = torch.where(going, size / curvature.where(going, ones), 0.0)
        out.addcmul_(direction, length.expand_as(out))
        residual.addcmul_(image, length.expand_as(out), value=-1)
        way = precondition(residual)
        before, size = size, torch.where(going, (residual * way).sum(0), size)
        direction = torch.addcmul(way, direction, (size / before.where(before > 0.0, ones)).expand_as(way))
    reached = (size / begun.where(begun > 0.0, ones)).clamp(min=0.0).sqrt()
    return out, iterations, float(reached.nan_to_num(torch.inf).max())


class NotNearlyLinearError(DivergenceError):
    """Conjugate gradients did not converge: the hidden units bend what their weights do."""


class FeatureSystem(System):
    """Of an embedded network with as many hidden units as outputs, or more.

    Args:
        linear, total: See :class:`System`.
        prior: (outputs, F), variance of the coefficients under weights of unit variance, the constant last.
        further: Linearisations of quantities about which :meth:`explained` will be asked.

    Raises:
        NotNearlyLinearError: The low-rank matrix is singular in double precision.
    """

    def __init__(self, linear: Linearised, total: float, prior: Tensor, further: Sequence[Block] = ()) -> None:
        super().__init__(linear, total)
        self.features = [block.linear for block in self.blocks]
        pattern = pattern_of([*self.blocks, *further])
        blocks = normal_blocks(self.features)
        for output, variance in enumerate(prior):
            blocks[output, output].diagonal().add_(total / variance)
        try:
            self.factor = BlockCholesky(pattern, blocks)
        except FloatingPointError as error:
            raise NotNearlyLinearError(
                "gauss_newton diverged: the normal matrix of its features is singular"
            ) from error
        self.iterations = 0

    def without_parameters(self, right: Tensor) -> Tensor:
        """See :meth:`System.without_parameters`; of the linear model (Woodbury)."""
        return right - push(self.features, [self._coefficients(right)])

    def solved(self, right: Tensor) -> Tensor:
        """See :meth:`System.solved`.

        Raises:
            NotNearlyLinearError: Too many iterations.
        """
        out, self.iterations, reached = conjugate_gradients(
            self._applied, self.with_parameters, right, STEP_TOLERANCE, MOST_ITERATIONS
        )
        if reached > LEAST_TOLERANCE:
            raise NotNearlyLinearError(
                f"gauss_newton diverged: {MOST_ITERATIONS} iterations did not solve a step; try network.width of twice"
                " the size, or so few training.collocation_points that training.most_residuals allows a whole matrix"
            )
        return out

    def probed(self, signs: Tensor) -> Tensor:
        """See :meth:`System.probed`."""
        return conjugate_gradients(self._applied, self.with_parameters, signs, PROBE_TOLERANCE, MOST_ITERATIONS)[0]

    def explained(self, block: Block) -> tuple[Tensor, Tensor]:
        """See :meth:`System.explained`; of the linear model."""
        follows, inverse = self._coefficients(self.by_parameter), self.factor.inverse
        variance, coupling = [], []
        for part in row_features(block.linear):
            pairs = ((i, left, j, right) for i, left in part.items() for j, right in part.items())
            variance.append(
                reduce(torch.add, (((left @ entry(inverse, i, j)) * right).sum(1) for i, left, j, right in pairs))
            )
            coupling.append(reduce(torch.add, (c @ follows[i] for i, c in part.items())))
        return torch.cat(variance), torch.cat(coupling)

    def missed_unknowns(self) -> float:
        """Unknowns that the residuals determine and the linear model has not, as a share of those that it has."""
        signs = probes(self.by_parameter, 0)
        linear, whole = signs - self.with_parameters(signs), signs - self.probed(signs)
        return float(((whole - linear) * signs).sum() / (linear * signs).sum())

    def _applied(self, values: Tensor) -> Tensor:
        out = push(self.blocks, pull(self.blocks, values)).div_(self.total).add_(values)
        return out.addmm_(self.by_parameter, self.by_parameter.T @ values)

    def _coefficients(self, values: Tensor) -> Tensor:
        """(outputs, F, k), what values (M, k) of the residuals ask of the features."""
        return torch.stack(self.factor.solved(list(pull(self.features, values)[0])))


def follows_features(network: MlpNetwork) -> bool:
    """Whether outputs can follow the embedding's features, each for itself."""
    narrowest = min(weight.shape[1] for weight in network.weights[1:])
    return network.inputs.count > 1 and network.channels * network.ndof <= narrowest


@torch.no_grad()
def coefficient_prior(network: MlpNetwork, time: Tensor) -> Tensor:
    """(outputs, F): variance of the outputs' coefficients of the features under weights of unit variance.

    Slopes of the hidden units are averaged over times (P,), s.
    """
    slopes, means = network.mean_slopes(time)
    first = slopes[0].square().sum(1)
    constant = first + sum(
        slope.square().sum(1) * (1.0 + float(mean.square().sum()))
        for slope, mean in zip(slopes[1:], means[1:], strict=True)
    )
    return torch.cat((first[:, None].expand(-1, network.inputs.count), constant[:, None]), 1)


def normal_blocks(features: Sequence[Block]) -> Blocks:
    """J' J of the linear model of the units, block by block of two outputs."""
    layer = features[0].layers[0]
    size, outputs = layer.inputs.shape[2], layer.sensitivity.shape[3]
    out: Blocks = {(i, i): layer.inputs.new_zeros(size, size) for i in range(outputs)}
    for block in features:
        for part in row_features(block):
            for i, left in part.items():
                for j, right in part.items():
                    if i >= j:
                        out.setdefault((i, j), left.new_zeros(size, size)).addmm_(left.T, right)
    return out


def row_features(block: Block) -> Iterator[dict[int, Tensor]]:
    """By row of a block of the linear model and output, (P, F): derivative of the row by the output's coefficients."""
    layer = block.layers[0]
    for row, outputs in enumerate(block.outputs):
        part = {}
        for output in outputs:
            by = layer.sensitivity[:, row, :, output]
            derivatives = [q for q in range(by.shape[1]) if output in layer.active[row][q]]
            part[output] = reduce(torch.add, (layer.inputs[q] * by[:, q, None] for q in derivatives))
        yield part


def pattern_of(blocks: Sequence[Block]) -> BlockPattern:
    """Which outputs some residual looks at together."""
    coupled = np.eye(blocks[0].layers[-1].sensitivity.shape[3], dtype=bool)
    for block in blocks:
        for outputs in block.outputs:
            coupled[np.ix_(outputs, outputs)] = True
    return BlockPattern(coupled)


def feature_operations(blocks: Sequence[Block]) -> float:
    """Multiplications and additions of a step from the low-rank factor."""
    pattern, features = pattern_of(blocks), blocks[0].layers[0].inputs.shape[2]
    outputs = [(len(active), block.points) for block in blocks for active in block.outputs]
    together = sum(count * (count + 1) * points for count, points in outputs)
    weights = sum(layer.inputs.shape[2] * layer.sensitivity.shape[3] for layer in blocks[0].layers)
    weights += features * len(pattern.order)
    points = sum(4.0 * len(block.layers[0].inputs) * block.points for block in blocks)
    per_column = points * weights + 4.0 * features**2 * len(pattern.places)
    columns = USUAL_ITERATIONS + USUAL_PROBE_ITERATIONS * TRACE_PROBES
    return together * features**2 + pattern.operations * features**3 + columns * per_column
