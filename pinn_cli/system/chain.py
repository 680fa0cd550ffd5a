"""The chain of masses, fixed at its first connection: the paper's structure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import MASS
from pinn_cli.system.structure import Structure

if TYPE_CHECKING:
    import torch

    from pinn_cli.system.connection.base import Nonlinearity


def chain_of(parameters: dict[str, torch.Tensor], nonlinearity: Nonlinearity) -> Structure:
    """Masses in a row; connection i joins DOF i-1 to DOF i, the first one the ground to DOF 1.

    Its elongations are e_i = u_i - u_{i-1} with u_0 = 0, so the equation of motion of DOF i is
    m_i a_i + r_i - r_{i+1} = f_i with r_{n+1} = 0 (paper, section 2).

    Args:
        parameters: "m", "c", "k" and those of the nonlinearity, each (ndof,).
        nonlinearity: Of every connection.

    Raises:
        ValueError: The names or the shapes of the parameters do not fit.
    """
    ndof = parameters[MASS].shape[-1] if MASS in parameters else 1
    return Structure(parameters, (ConnectionGroup(nonlinearity, Incidence.chain(ndof)),))
