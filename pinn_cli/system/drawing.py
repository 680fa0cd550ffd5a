"""The chain as text."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pinn_cli.system.structure import Structure


def draw(structure: Structure) -> str:
    """The chain from its fixed end, one connection and one mass a line.

    >>> from pinn_cli.system.building import build_chain
    >>> from pinn_cli.system.connection.duffing import Duffing
    >>> print(draw(build_chain(2, Duffing(), m=10.0, c=1.0, k=[15.0, 14.0], kappa=100.0)))
    ///
     |   c_1 = 1  k_1 = 15  kappa_1 = 100
    (1)  m_1 = 10
     |   c_2 = 1  k_2 = 14  kappa_2 = 100
    (2)  m_2 = 10
    """
    lines = ["///"]
    for dof in range(1, structure.ndof + 1):
        labels = {name: f"{name}_{dof} = {value[dof - 1].item():g}" for name, value in structure.parameters.items()}
        mass = labels.pop("m")
        lines += [f"{'|':^3}  {'  '.join(labels.values())}".rstrip(), f"{f'({dof})':<3}  {mass}"]
    return "\n".join(lines)
