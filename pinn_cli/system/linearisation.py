"""The internal forces of a structure, linearised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from pinn_cli.system.parameters import MASS, Parameter


def slopes(function: Callable[..., torch.Tensor], *given: torch.Tensor) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """What a function makes of tensors, and the derivatives of its sum by each of them, as large as they are.

    Forces are elementwise in time and connection: one reverse pass through their sum gives every derivative of each.
    """
    leaves = [x.detach().requires_grad_() for x in given]
    with torch.enable_grad():
        value = function(*leaves)
        by = torch.autograd.grad(value.sum(), leaves, allow_unused=True, materialize_grads=True)
    return value.detach(), list(by)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The connections' internal force and its derivatives, each (..., C).

    Attributes:
        force: r, N.
        stiffness, damping: dr/de, dr/d(de/dt).
        by_parameter: Kind to dr/d(parameter) of the connections that have it (..., carriers), see
            :attr:`pinn_cli.system.structure.Structure.carriers`; without the mass, on which r does not depend.
    """

    force: torch.Tensor
    stiffness: torch.Tensor
    damping: torch.Tensor
    by_parameter: dict[str, torch.Tensor]

    def by_parameters(self, parameters: Sequence[Parameter], acceleration: torch.Tensor) -> torch.Tensor:
        """(..., p), what single parameters do to the force of their own connection, or to the inertia of their mass.

        Args:
            parameters: p of them.
            acceleration: (..., n), of the masses.
        """
        own = [(acceleration if p.kind == MASS else self.by_parameter[p.kind])[..., p.index] for p in parameters]
        return torch.stack(own, -1) if own else acceleration.new_zeros((*acceleration.shape[:-1], 0))
