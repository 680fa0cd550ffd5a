"""The linear system of a Gauss-Newton step in the space of the residuals, and what is known once it is solved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.block_cholesky import BlockCholesky, BlockPattern, Blocks
from pinn_cli.training.function_space.kernel import Block, RowPairs, kernel

# Random signs that estimate how many residuals each group keeps; their scatter is a few in a thousand residuals.
PROBES = 16


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
        """J J', its lower triangle."""
        return kernel(self.blocks)


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
    """(M, ``PROBES``) random signs, the same on every device."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 2, (len(like), PROBES), generator=generator).to(like) * 2.0 - 1.0


class DenseSystem(System):
    """Of any network, by the Cholesky factor of the whole matrix.

    Args:
        linear, total: See :class:`System`.

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
        across = torch.cat([cross_kernel(known, block) for known in self.blocks]) / self.total
        half = torch.cat(self.factor.forward(list(across.split(self.heights))))
        by_parameter = torch.cat(self.factor.forward(list(self.by_parameter.split(self.heights))))
        return block.variance.flatten() / self.total - half.square().sum(0), half.T @ by_parameter


def cross_kernel(here: Block, there: Block) -> Tensor:
    """J_here J_there', (M_here, M_there)."""
    pairs = RowPairs(here, there)
    return torch.cat([torch.cat([pairs(i, j) for j in range(there.rows)], 1) for i in range(here.rows)])


def dense_operations(blocks: Sequence[Block]) -> float:
    """Multiplications and additions of a step with the whole matrix."""
    residuals = sum(block.size for block in blocks)
    units = sum(layer.sensitivity.shape[3] for layer in blocks[0].layers[:-1])
    derivatives = len(blocks[0].layers[0].inputs)
    return float(residuals) ** 2 * (derivatives**2 * units + residuals / 3.0 + 2.0 * PROBES)
