"""The paper's matrices, for users who want them and for tests; nothing in the product computes with them.

Section 2 and the appendix of the paper, misprints put right (the last off-diagonals of C and K are -c_n and -k_n; g_k
holds elongations cubed, not rates). With E the elongation operator (e = E u, E_ii = 1, E_i,i-1 = -1): C = E' diag(c) E,
C_n = E' diag(mu). All are float64 tensors and keep the graph of the chain's parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.system.chain import Chain
    from pinn_cli.system.connection.base import Nonlinearity


def mass(chain: Chain) -> torch.Tensor:
    """M = diag(m), (n, n), kg."""
    return torch.diag(_parameter(chain, "m"))


def damping(chain: Chain) -> torch.Tensor:
    """C, (n, n), N s/m: tridiagonal."""
    e = _elongation_operator(chain)
    return e.T @ torch.diag(_parameter(chain, "c")) @ e


def stiffness(chain: Chain) -> torch.Tensor:
    """K, (n, n), N/m: tridiagonal."""
    e = _elongation_operator(chain)
    return e.T @ torch.diag(_parameter(chain, "k")) @ e


def nonlinear_damping(chain: Chain) -> torch.Tensor:
    """C_n, (n, n): upper bidiagonal in the nonlinearity's damping parameter; zero where it has none."""
    return _connection_matrix(chain, chain.nonlinearity.damping_parameter)


def nonlinear_stiffness(chain: Chain) -> torch.Tensor:
    """K_n, (n, n): upper bidiagonal in the nonlinearity's stiffness parameter; zero where it has none."""
    return _connection_matrix(chain, chain.nonlinearity.stiffness_parameter)


def nonlinear_functions(chain: Chain, u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """g_n = {g_k, g_c}, (..., 2n): the nonlinear functions of displacement and velocity that K_n and C_n multiply.

    Each is the nonlinearity's own force with its coefficient at one, so that no formula stands twice.
    """
    e, de = chain.elongation(u), chain.elongation(v)
    return torch.cat([_unit_force(chain.nonlinearity, name, e, de) for name in _coefficients(chain.nonlinearity)], -1)


def state(chain: Chain) -> torch.Tensor:
    """A, (2n, 2n), of dz/dt = A z + A_n g_n + H f with z = {u, v}."""
    top = torch.cat([_zeros(chain), _identity(chain)], 1)
    return torch.cat([top, _acceleration_rows(chain, stiffness(chain), damping(chain))])


def nonlinear_state(chain: Chain) -> torch.Tensor:
    """A_n, (2n, 2n)."""
    top = torch.cat([_zeros(chain), _zeros(chain)], 1)
    return torch.cat([top, _acceleration_rows(chain, nonlinear_stiffness(chain), nonlinear_damping(chain))])


def input(chain: Chain) -> torch.Tensor:  # noqa: A001 - the name that control theory has for it
    """H, (2n, n)."""
    return torch.cat([_zeros(chain), torch.diag(1.0 / _parameter(chain, "m"))])


def selection(dofs: Sequence[int], ndof: int) -> torch.Tensor:
    """S, (len(dofs), ndof): picks the DOFs (counted from 1) that are measured; the paper's S_d, S_v, S_a."""
    matrix = torch.zeros(len(dofs), ndof, dtype=torch.float64)
    for row, dof in enumerate(dofs):
        if not 1 <= dof <= ndof:
            raise ValueError(f"DOF {dof} is outside 1..{ndof}")
        matrix[row, dof - 1] = 1.0
    return matrix


def output(
    chain: Chain, displacement: Sequence[int] = (), velocity: Sequence[int] = (), acceleration: Sequence[int] = ()
) -> torch.Tensor:
    """B, (sensors, 2n), of y = B z + B_n g_n + D f, for sensors on the given DOFs (counted from 1)."""
    return torch.cat(
        [
            selection(displacement, chain.ndof) @ torch.cat([_identity(chain), _zeros(chain)], 1),
            selection(velocity, chain.ndof) @ torch.cat([_zeros(chain), _identity(chain)], 1),
            selection(acceleration, chain.ndof) @ state(chain)[chain.ndof :],
        ]
    )


def nonlinear_output(
    chain: Chain, displacement: Sequence[int] = (), velocity: Sequence[int] = (), acceleration: Sequence[int] = ()
) -> torch.Tensor:
    """B_n, (sensors, 2n)."""
    quiet = torch.zeros(len(displacement) + len(velocity), 2 * chain.ndof, dtype=torch.float64)
    return torch.cat([quiet, selection(acceleration, chain.ndof) @ nonlinear_state(chain)[chain.ndof :]])


def feedthrough(
    chain: Chain, displacement: Sequence[int] = (), velocity: Sequence[int] = (), acceleration: Sequence[int] = ()
) -> torch.Tensor:
    """D, (sensors, n)."""
    quiet = torch.zeros(len(displacement) + len(velocity), chain.ndof, dtype=torch.float64)
    return torch.cat([quiet, selection(acceleration, chain.ndof) @ input(chain)[chain.ndof :]])


def _parameter(chain: Chain, name: str) -> torch.Tensor:
    return chain.parameters[name].to(torch.float64)


def _zeros(chain: Chain) -> torch.Tensor:
    return torch.zeros(chain.ndof, chain.ndof, dtype=torch.float64)


def _identity(chain: Chain) -> torch.Tensor:
    return torch.eye(chain.ndof, dtype=torch.float64)


def _elongation_operator(chain: Chain) -> torch.Tensor:
    return chain.elongation(_identity(chain)).T


def _acceleration_rows(chain: Chain, of_displacement: torch.Tensor, of_velocity: torch.Tensor) -> torch.Tensor:
    return -torch.cat([of_displacement, of_velocity], 1) / _parameter(chain, "m")[:, None]


def _coefficients(nonlinearity: Nonlinearity) -> tuple[str | None, str | None]:
    pair = (nonlinearity.stiffness_parameter, nonlinearity.damping_parameter)
    if {name for name in pair if name} != set(nonlinearity.parameters):
        raise ValueError(
            f"{nonlinearity.name} has no matrix form: not every parameter is the coefficient of K_n or C_n"
        )
    return pair


def _connection_matrix(chain: Chain, parameter: str | None) -> torch.Tensor:
    _coefficients(chain.nonlinearity)
    if parameter is None:
        return _zeros(chain)
    return _elongation_operator(chain).T @ torch.diag(_parameter(chain, parameter))


def _unit_force(nonlinearity: Nonlinearity, name: str | None, e: torch.Tensor, de: torch.Tensor) -> torch.Tensor:
    if name is None:
        return torch.zeros_like(e)
    coefficients = {other: torch.full_like(e, float(other == name)) for other in nonlinearity.parameters}
    return nonlinearity.force(e, de, coefficients)
