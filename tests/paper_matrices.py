"""The paper's matrices, for users who want them and for tests; nothing in the product computes with them.

Section 2 and the appendix of the paper, misprints put right (the last off-diagonals of C and K are -c_n and -k_n; g_k
holds elongations cubed, not rates). With E the elongation operator (e = E u, E_ii = 1, E_i,i-1 = -1): C = E' diag(c) E,
C_n = E' diag(mu). All are float64 tensors and keep the graph of the chain's parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from pinn_cli.system.structure import Structure


def mass(structure: Structure) -> torch.Tensor:
    """M = diag(m), (n, n), kg."""
    return torch.diag(structure.parameters["m"].double())


def damping(structure: Structure) -> torch.Tensor:
    """C, (n, n), N s/m: tridiagonal."""
    return _pull(structure, "c") @ _elongation(structure)


def stiffness(structure: Structure) -> torch.Tensor:
    """K, (n, n), N/m: tridiagonal."""
    return _pull(structure, "k") @ _elongation(structure)


def nonlinear_damping(structure: Structure) -> torch.Tensor:
    """C_n, (n, n): upper bidiagonal in the nonlinearity's damping parameter; zero where it has none."""
    return _pull(structure, _coefficients(structure)[1])


def nonlinear_stiffness(structure: Structure) -> torch.Tensor:
    """K_n, (n, n): upper bidiagonal in the nonlinearity's stiffness parameter; zero where it has none."""
    return _pull(structure, _coefficients(structure)[0])


def nonlinear_functions(structure: Structure, u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """g_n = {g_k, g_c}, (..., 2n): the nonlinear functions of displacement and velocity that K_n and C_n multiply.

    Each is the nonlinearity's own force with its coefficient at one, so that no formula stands twice.
    """
    e, de, law = structure.elongation(u), structure.elongation(v), structure.nonlinearity
    ones = [{p: torch.full_like(e, float(p == name)) for p in law.parameters} for name in _coefficients(structure)]
    return torch.cat(
        [law.force(e, de, given) if any(map(torch.any, given.values())) else 0.0 * e for given in ones], -1
    )


def state(structure: Structure) -> torch.Tensor:
    """A, (2n, 2n), of dz/dt = A z + A_n g_n + H f with z = {u, v}."""
    top = torch.cat([torch.zeros(mass(structure).shape), torch.eye(structure.ndof, dtype=torch.float64)], 1)
    return torch.cat([top, _accelerations(structure, stiffness(structure), damping(structure))])


def nonlinear_state(structure: Structure) -> torch.Tensor:
    """A_n, (2n, 2n)."""
    rows = _accelerations(structure, nonlinear_stiffness(structure), nonlinear_damping(structure))
    return torch.cat([torch.zeros_like(rows), rows])


def input(structure: Structure) -> torch.Tensor:  # noqa: A001 - the name that control theory has for it
    """H, (2n, n)."""
    inverse = torch.linalg.inv(mass(structure))
    return torch.cat([torch.zeros_like(inverse), inverse])


def selection(dofs: Sequence[int], ndof: int) -> torch.Tensor:
    """S, (len(dofs), ndof): picks the DOFs (counted from 1) that are measured; the paper's S_d, S_v, S_a."""
    for dof in dofs:
        if not 1 <= dof <= ndof:
            raise ValueError(f"DOF {dof} is outside 1..{ndof}")
    return torch.eye(ndof, dtype=torch.float64)[[dof - 1 for dof in dofs]]


def outputs(
    structure: Structure,
    displacement: Sequence[int] = (),
    velocity: Sequence[int] = (),
    acceleration: Sequence[int] = (),
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """B (sensors, 2n), B_n (sensors, 2n) and D (sensors, n) of y = B z + B_n g_n + D f, sensors on DOFs from 1."""
    n = structure.ndof
    motion = torch.block_diag(selection(displacement, n), selection(velocity, n))
    accelerometers, quiet = selection(acceleration, n), torch.zeros(len(motion), 2 * n, dtype=torch.float64)
    b, b_n, d = (accelerometers @ x(structure)[n:] for x in (state, nonlinear_state, input))
    return torch.cat([motion, b]), torch.cat([quiet, b_n]), torch.cat([quiet[:, :n], d])


def _elongation(structure: Structure) -> torch.Tensor:
    return structure.elongation(torch.eye(structure.ndof, dtype=torch.float64)).T


def _pull(structure: Structure, parameter: str | None) -> torch.Tensor:
    """E' diag(p), (n, n); zero where there is no such parameter."""
    e = _elongation(structure).T
    return 0.0 * e if parameter is None else e * structure.parameters[parameter].double()


def _accelerations(structure: Structure, of_displacement: torch.Tensor, of_velocity: torch.Tensor) -> torch.Tensor:
    return -torch.cat([of_displacement, of_velocity], 1) / structure.parameters["m"].double()[:, None]


def _coefficients(structure: Structure) -> tuple[str | None, str | None]:
    """Of K_n and of C_n."""
    law = structure.nonlinearity
    pair = (law.stiffness_parameter, law.damping_parameter)
    if {name for name in pair if name} != set(law.parameters):
        raise ValueError(f"{law.name} has no matrix form: not every parameter is the coefficient of K_n or C_n")
    return pair
