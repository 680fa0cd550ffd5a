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

    from pinn_cli.system.connection.base import Nonlinearity
    from pinn_cli.system.structure import Structure


def mass(structure: Structure) -> torch.Tensor:
    """M = diag(m), (n, n), kg."""
    return torch.diag(_parameter(structure, "m"))


def damping(structure: Structure) -> torch.Tensor:
    """C, (n, n), N s/m: tridiagonal."""
    e = _elongation_operator(structure)
    return e.T @ torch.diag(_parameter(structure, "c")) @ e


def stiffness(structure: Structure) -> torch.Tensor:
    """K, (n, n), N/m: tridiagonal."""
    e = _elongation_operator(structure)
    return e.T @ torch.diag(_parameter(structure, "k")) @ e


def nonlinear_damping(structure: Structure) -> torch.Tensor:
    """C_n, (n, n): upper bidiagonal in the nonlinearity's damping parameter; zero where it has none."""
    return _connection_matrix(structure, structure.nonlinearity.damping_parameter)


def nonlinear_stiffness(structure: Structure) -> torch.Tensor:
    """K_n, (n, n): upper bidiagonal in the nonlinearity's stiffness parameter; zero where it has none."""
    return _connection_matrix(structure, structure.nonlinearity.stiffness_parameter)


def nonlinear_functions(structure: Structure, u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """g_n = {g_k, g_c}, (..., 2n): the nonlinear functions of displacement and velocity that K_n and C_n multiply.

    Each is the nonlinearity's own force with its coefficient at one, so that no formula stands twice.
    """
    e, de = structure.elongation(u), structure.elongation(v)
    return torch.cat(
        [_unit_force(structure.nonlinearity, name, e, de) for name in _coefficients(structure.nonlinearity)], -1
    )


def state(structure: Structure) -> torch.Tensor:
    """A, (2n, 2n), of dz/dt = A z + A_n g_n + H f with z = {u, v}."""
    top = torch.cat([_zeros(structure), _identity(structure)], 1)
    return torch.cat([top, _acceleration_rows(structure, stiffness(structure), damping(structure))])


def nonlinear_state(structure: Structure) -> torch.Tensor:
    """A_n, (2n, 2n)."""
    top = torch.cat([_zeros(structure), _zeros(structure)], 1)
    return torch.cat([top, _acceleration_rows(structure, nonlinear_stiffness(structure), nonlinear_damping(structure))])


def input(structure: Structure) -> torch.Tensor:  # noqa: A001 - the name that control theory has for it
    """H, (2n, n)."""
    return torch.cat([_zeros(structure), torch.diag(1.0 / _parameter(structure, "m"))])


def selection(dofs: Sequence[int], ndof: int) -> torch.Tensor:
    """S, (len(dofs), ndof): picks the DOFs (counted from 1) that are measured; the paper's S_d, S_v, S_a."""
    matrix = torch.zeros(len(dofs), ndof, dtype=torch.float64)
    for row, dof in enumerate(dofs):
        if not 1 <= dof <= ndof:
            raise ValueError(f"DOF {dof} is outside 1..{ndof}")
        matrix[row, dof - 1] = 1.0
    return matrix


def output(
    structure: Structure,
    displacement: Sequence[int] = (),
    velocity: Sequence[int] = (),
    acceleration: Sequence[int] = (),
) -> torch.Tensor:
    """B, (sensors, 2n), of y = B z + B_n g_n + D f, for sensors on the given DOFs (counted from 1)."""
    return torch.cat(
        [
            selection(displacement, structure.ndof) @ torch.cat([_identity(structure), _zeros(structure)], 1),
            selection(velocity, structure.ndof) @ torch.cat([_zeros(structure), _identity(structure)], 1),
            selection(acceleration, structure.ndof) @ state(structure)[structure.ndof :],
        ]
    )


def nonlinear_output(
    structure: Structure,
    displacement: Sequence[int] = (),
    velocity: Sequence[int] = (),
    acceleration: Sequence[int] = (),
) -> torch.Tensor:
    """B_n, (sensors, 2n)."""
    quiet = torch.zeros(len(displacement) + len(velocity), 2 * structure.ndof, dtype=torch.float64)
    return torch.cat([quiet, selection(acceleration, structure.ndof) @ nonlinear_state(structure)[structure.ndof :]])


def feedthrough(
    structure: Structure,
    displacement: Sequence[int] = (),
    velocity: Sequence[int] = (),
    acceleration: Sequence[int] = (),
) -> torch.Tensor:
    """D, (sensors, n)."""
    quiet = torch.zeros(len(displacement) + len(velocity), structure.ndof, dtype=torch.float64)
    return torch.cat([quiet, selection(acceleration, structure.ndof) @ input(structure)[structure.ndof :]])


def _parameter(structure: Structure, name: str) -> torch.Tensor:
    return structure.parameters[name].to(torch.float64)


def _zeros(structure: Structure) -> torch.Tensor:
    return torch.zeros(structure.ndof, structure.ndof, dtype=torch.float64)


def _identity(structure: Structure) -> torch.Tensor:
    return torch.eye(structure.ndof, dtype=torch.float64)


def _elongation_operator(structure: Structure) -> torch.Tensor:
    return structure.elongation(_identity(structure)).T


def _acceleration_rows(structure: Structure, of_displacement: torch.Tensor, of_velocity: torch.Tensor) -> torch.Tensor:
    return -torch.cat([of_displacement, of_velocity], 1) / _parameter(structure, "m")[:, None]


def _coefficients(nonlinearity: Nonlinearity) -> tuple[str | None, str | None]:
    pair = (nonlinearity.stiffness_parameter, nonlinearity.damping_parameter)
    if {name for name in pair if name} != set(nonlinearity.parameters):
        raise ValueError(
            f"{nonlinearity.name} has no matrix form: not every parameter is the coefficient of K_n or C_n"
        )
    return pair


def _connection_matrix(structure: Structure, parameter: str | None) -> torch.Tensor:
    _coefficients(structure.nonlinearity)
    if parameter is None:
        return _zeros(structure)
    return _elongation_operator(structure).T @ torch.diag(_parameter(structure, parameter))


def _unit_force(nonlinearity: Nonlinearity, name: str | None, e: torch.Tensor, de: torch.Tensor) -> torch.Tensor:
    if name is None:
        return torch.zeros_like(e)
    coefficients = {other: torch.full_like(e, float(other == name)) for other in nonlinearity.parameters}
    return nonlinearity.force(e, de, coefficients)
