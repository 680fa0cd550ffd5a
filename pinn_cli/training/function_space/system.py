"""The linear system of a Gauss-Newton step in the space of the residuals, and what is known once it is solved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import torch
from torch import Tensor

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.function_space.kernel import Block, cross_kernel, kernel, prior_variance

# Rows of a panel: between two panels Python looks at signals, three seconds of one core apart for 30 000 rows.
PANEL = 1024


def cholesky(matrix: Tensor) -> Tensor | None:
    """Lower Cholesky factor of a symmetric matrix (M, M), whose lower triangle is read; None where there is none.

    From four panels on the matrix is overwritten, panel after panel (right-looking; Golub and Van Loan 2013, section
    4.2.9): as many operations as in one call, and a tenth more time for 6000 rows.
    """
    if len(matrix) < 4 * PANEL:
        factor, failed = torch.linalg.cholesky_ex(matrix)
        return None if int(failed) else factor
    panels = [slice(first, min(first + PANEL, len(matrix))) for first in range(0, len(matrix), PANEL)]
    for number, panel in enumerate(panels):
        top, failed = torch.linalg.cholesky_ex(matrix[panel, panel])
        if int(failed):
            return None
        matrix[panel, panel] = top
        below = matrix[panel.stop :, panel]
        below.copy_(torch.linalg.solve_triangular(top, below.mT, upper=False).mT)
        for columns in panels[number + 1 :]:
            matrix[columns.start :, columns].addmm_(matrix[columns.start :, panel], matrix[columns, panel].mT, alpha=-1)
    return matrix.tril_()


# Random signs that estimate how many residuals each group keeps; their scatter is a few in a thousand residuals.
PROBES = 16


class System(ABC):
    """I + J J' / total + J_p J_p': M residuals by weights of precision ``total`` and by parameters of unit variance.

    Args:
        blocks: The residuals' linearisation.
        by_parameter: J_p, (M, p).
        total: Precision of the weights, damping included.
    """

    def __init__(self, blocks: list[Block], by_parameter: Tensor, total: float) -> None:
        self.blocks, self.by_parameter, self.total = blocks, by_parameter, total

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

    def kept(self, seed: int) -> Tensor:
        """(M,) diagonal of the inverse: how much of each residual the fit leaves free, from 0 to 1.

        N minus the effective number of unknowns gamma of a group (MacKay 1992) is the sum over its residuals. By
        Hutchinson's probes, so single values scatter; sums over hundreds do not.
        """
        signs = probes(self.by_parameter, seed)
        return (signs * self.solved(signs)).mean(1)

    @cached_property
    def parameter_covariance(self) -> Tensor:
        """(p, p), of the parameters in prior standard deviations, weights integrated out."""
        eye = torch.eye(self.by_parameter.shape[1]).to(self.by_parameter)
        return torch.linalg.inv(eye + self.by_parameter.T @ self._by_parameter_solved)

    @cached_property
    def _by_parameter_solved(self) -> Tensor:
        return self.without_parameters(self.by_parameter)

    def _with_parameters(self, right: Tensor, solved: Tensor) -> Tensor:
        """The whole system's solution from that of the system without its parameters (Woodbury)."""
        return solved - self._by_parameter_solved @ (self.parameter_covariance @ (self.by_parameter.T @ solved))


def probes(like: Tensor, seed: int) -> Tensor:
    """(M, ``PROBES``) random signs, the same on every device."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 2, (len(like), PROBES), generator=generator).to(like) * 2.0 - 1.0


class DenseSystem(System):
    """Of any network, by the Cholesky factor of the whole matrix.

    Args:
        blocks, by_parameter, total: See :class:`System`.
        kernel_of_all: J J', (M, M), its lower triangle; None: it is computed.

    Raises:
        DivergenceError: The system is singular in double precision.
    """

    def __init__(
        self, blocks: list[Block], by_parameter: Tensor, total: float, kernel_of_all: Tensor | None = None
    ) -> None:
        super().__init__(blocks, by_parameter, total)
        system = (kernel(blocks) if kernel_of_all is None else kernel_of_all) / total
        system.diagonal().add_(1.0)
        factor = cholesky(system)
        if factor is None:
            raise DivergenceError(
                "gauss_newton diverged: its normal matrix is singular; try network.width or training.collocation_points"
                " of half the size"
            )
        self.factor = factor

    def solved(self, right: Tensor) -> Tensor:
        """See :meth:`System.solved`."""
        return self._with_parameters(right, self.without_parameters(right))

    def without_parameters(self, right: Tensor) -> Tensor:
        """See :meth:`System.without_parameters`."""
        return torch.cholesky_solve(right, self.factor)

    def explained(self, block: Block) -> tuple[Tensor, Tensor]:
        """See :meth:`System.explained`."""
        across = torch.cat([cross_kernel(block, known) for known in self.blocks], 1) / self.total
        half = torch.linalg.solve_triangular(self.factor, across.T, upper=False)
        by_parameter = torch.linalg.solve_triangular(self.factor, self.by_parameter, upper=False)
        return prior_variance(block).flatten() / self.total - half.square().sum(0), half.T @ by_parameter
