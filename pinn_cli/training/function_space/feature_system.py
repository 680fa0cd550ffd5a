"""The system of a step where hidden units are nearly linear: a low-rank factor, and conjugate gradients from it.

As long as what the hidden units get hardly changes their slopes, a change of any weights moves the outputs by as many
combinations C of the embedding's features as there are outputs. The kernel is then that of C alone: of low rank, and
coupled between outputs only where an equation of motion couples them. Its factor costs a small part of that of the
whole kernel, and preconditions conjugate gradients on the whole one, whose products need no kernel at all. Bands come
from the factor: the linear model of the units, which is the better the smaller their first weights are
(:data:`pinn_cli.network.mlp.LINEAR_GAIN`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.block_cholesky import BlockCholesky, BlockPattern, Blocks, entry
from pinn_cli.training.function_space.kernel import Block
from pinn_cli.training.function_space.products import Products, sum_of, with_constant
from pinn_cli.training.function_space.system import System, probes

Operator = Callable[[Tensor], Tensor]
"""From (M, k) to (M, k), symmetric and positive definite."""


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
    begun, least, one = size, tolerance**2 * size, torch.ones_like(size)
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
        length = torch.where(going, size / curvature.where(going, one), 0.0)
        out.addcmul_(direction, length.expand_as(out))
        residual.addcmul_(image, length.expand_as(out), value=-1)
        way = precondition(residual)
        before, size = size, torch.where(going, (residual * way).sum(0), size)
        direction = torch.addcmul(way, direction, (size / before.where(before > 0.0, one)).expand_as(way))
    reached = (size / begun.where(begun > 0.0, one)).clamp(min=0.0).sqrt()
    return out, iterations, float(reached.nan_to_num(torch.inf).max())


# Of the residual in conjugate gradients, over the right-hand side, in the preconditioner's norm. A step's: with 1e-5
# the motion that is left bends the units and trainings take twice as many steps; rounding may keep it above that, and
# beyond the second it is no solution. That of probes, whose own scatter is larger.
STEP_TOLERANCE, LEAST_TOLERANCE, PROBE_TOLERANCE = 1e-8, 1e-5, 1e-2
MOST_ITERATIONS = 150


class NotNearlyLinearError(DivergenceError):
    """Conjugate gradients did not converge: the hidden units bend what their weights do."""


class FeatureSystem(System):
    """Of an embedded network with as many hidden units as outputs, or more.

    Args:
        products: Of the linearisation.
        by_parameter, total: See :class:`System`.
        prior: (outputs, F), variance of the coefficients under weights of unit variance, the constant last.
        further: Linearisations of quantities about which :meth:`explained` will be asked.

    Raises:
        NotNearlyLinearError: The low-rank matrix is singular in double precision.
    """

    def __init__(
        self, products: Products, by_parameter: Tensor, total: float, prior: Tensor, further: list[Block]
    ) -> None:
        super().__init__(products.blocks, by_parameter, total)
        self.products = products
        self.pattern = pattern_of([*products.blocks, *further])
        self.order, self.rank = (
            torch.as_tensor(x, device=prior.device) for x in (self.pattern.order, self.pattern.rank)
        )
        blocks = normal_blocks(self.pattern, products)
        for step, output in enumerate(self.pattern.order):
            blocks[step, step].diagonal().add_(total / prior[output])
        try:
            self.factor = BlockCholesky(self.pattern, blocks)
        except FloatingPointError as error:
            raise NotNearlyLinearError(
                "gauss_newton diverged: the normal matrix of its features is singular"
            ) from error
        self.iterations = 0

    def without_parameters(self, right: Tensor) -> Tensor:
        """See :meth:`System.without_parameters`; of the linear model (Woodbury)."""
        return right - self.products.from_features(self._solved_features(right))

    def solved(self, right: Tensor) -> Tensor:
        """See :meth:`System.solved`.

        Raises:
            NotNearlyLinearError: Too many iterations.
        """
        out, self.iterations, reached = conjugate_gradients(
            self._applied, self._preconditioned, right, STEP_TOLERANCE, MOST_ITERATIONS
        )
        if reached > LEAST_TOLERANCE:
            raise NotNearlyLinearError(
                f"gauss_newton diverged: {MOST_ITERATIONS} iterations did not solve a step; try network.width of twice"
                " the size, or so few training.collocation_points that training.most_residuals allows a whole matrix"
            )
        return out

    def kept(self, seed: int) -> Tensor:
        """See :meth:`System.kept`."""
        signs = probes(self.by_parameter, seed)
        return (signs * self._probed(signs)).mean(1)

    def explained(self, block: Block) -> tuple[Tensor, Tensor]:
        """See :meth:`System.explained`; of the linear model."""
        follows = self._solved_features(self.by_parameter)
        inverse = self.factor.inverse
        inputs, sensitivity = with_constant(block.inputs[0]), block.sensitivity[-1]
        variance, coupling = [], []
        for row, outputs in enumerate(active_outputs(block)):
            part = {self.pattern.rank[o]: _row_features(inputs, sensitivity[:, row, :, o]) for o in outputs}
            total = sum_of([((c @ entry(inverse, i, j)) * d).sum(1) for i, c in part.items() for j, d in part.items()])
            variance.append(total)
            coupling.append(sum_of([c @ follows[self.pattern.order[i]] for i, c in part.items()]))
        return torch.cat(variance), torch.cat(coupling)

    def missed_unknowns(self) -> float:
        """Unknowns that the residuals determine and the linear model has not, as a share of those that it has."""
        signs = probes(self.by_parameter, 0)
        linear = signs - self._preconditioned(signs)
        whole = signs - self._probed(signs)
        return float(((whole - linear) * signs).sum() / (linear * signs).sum())

    def _probed(self, signs: Tensor) -> Tensor:
        return conjugate_gradients(self._applied, self._preconditioned, signs, PROBE_TOLERANCE, MOST_ITERATIONS)[0]

    def _applied(self, values: Tensor) -> Tensor:
        out = self.products.kernel(values).div_(self.total).add_(values)
        return out.addmm_(self.by_parameter, self.by_parameter.T @ values)

    def _preconditioned(self, values: Tensor) -> Tensor:
        return self._with_parameters(values, self.without_parameters(values))

    def _solved_features(self, values: Tensor) -> Tensor:
        pulled = self.products.to_features(values)[self.order]
        return self.factor.solved(pulled)[self.rank]


def normal_blocks(pattern: BlockPattern, products: Products) -> Blocks:
    """J' J of the linear model of the units, block by block of two outputs."""
    like = products.linear[0].inputs
    size = like.shape[2]
    out = {place: like.new_zeros(size, size) for place in pattern.places}
    for block, linear in zip(products.blocks, products.linear, strict=True):
        sensitivity = block.sensitivity[-1]
        for row, outputs in enumerate(active_outputs(block)):
            part = {pattern.rank[o]: _row_features(linear.inputs, sensitivity[:, row, :, o]) for o in outputs}
            for i, left in part.items():
                for j, right in part.items():
                    if i >= j:
                        out[i, j].addmm_(left.T, right)
    return out


def pattern_of(blocks: list[Block]) -> BlockPattern:
    """Which outputs some residual looks at together."""
    count = blocks[0].sensitivity[-1].shape[3]
    coupled = np.eye(count, dtype=bool)
    for block in blocks:
        for outputs in active_outputs(block):
            coupled[np.ix_(outputs, outputs)] = True
    return BlockPattern(coupled)


def active_outputs(block: Block) -> list[list[int]]:
    """By row, the outputs that it depends on anywhere."""
    return [row.nonzero()[:, 0].tolist() for row in block.sensitivity[-1].ne(0).any(2).any(0).cpu()]


def _row_features(inputs: Tensor, sensitivity: Tensor) -> Tensor:
    """(P, F), derivative of a row (P,) by one output's coefficients, from its sensitivity (Q, P)."""
    out = inputs[0] * sensitivity[0, :, None]
    for order in range(1, len(inputs)):
        if bool(sensitivity[order].any()):
            out.addcmul_(inputs[order], sensitivity[order, :, None])
    return out
