"""Preconditioned conjugate gradients for many right-hand sides side by side."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

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
