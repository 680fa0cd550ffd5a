"""From what a user writes in a config to a chain, with every rule about legal values of `system`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import USABLE, entries, is_finite_number, is_usable_number, whole_number
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import LINEAR_UNITS, MASS
from pinn_cli.system.structure import Structure
from pinn_cli.system.whole_damping import damped

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pinn_cli.system.connection.base import Nonlinearity

# What an estimator holds grows with the square of this number;
# `pinn_cli.training.normal_matrix.layout` counts it for a record.
MOST_DOFS = 2000


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


def build_chain(
    ndof: int,
    nonlinearity: Nonlinearity,
    damping: Mapping[str, Any] | None = None,
    **parameters: float | Sequence[float],
) -> Structure:
    """A chain from numbers (the same for every connection) or lists of ndof numbers.

    Args:
        ndof: Number of degrees of freedom.
        nonlinearity: Which decides what parameters there are beyond m, c and k.
        damping: Of the whole, see :func:`pinn_cli.system.whole_damping.damped`; beside it c is 0 unless given.
        **parameters: m (kg), c (N s/m), k (N/m), and kappa (N/m^3) or mu, each a number or a list of ndof numbers.

    Raises:
        InputError: Naming ``system.<parameter>``: ndof is no positive integer; a parameter is missing, unknown, of the
            wrong length, not finite or of a sign that makes no sense.
    """
    nonlinearity = _with_given(nonlinearity, parameters)
    for name in (*LINEAR_UNITS, *nonlinearity.parameters):
        if parameters.get(name) is None and (name != "c" or damping is None):
            names = ", ".join((*LINEAR_UNITS, *nonlinearity.parameters))
            raise InputError(f"system.{name}", "nothing", f"given: a {nonlinearity.name} chain has {names}")
    structure = build_partial_chain(ndof, nonlinearity, damping, **parameters)
    for name, tensor in structure.parameters.items():
        if tensor.isnan().any():
            raise InputError(
                f"system.{name}",
                parameters.get(name, damping),
                "given in every entry: null is for what is unknown of a record",
            )
    return structure


def build_partial_chain(
    ndof: int,
    nonlinearity: Nonlinearity,
    damping: Mapping[str, Any] | None = None,
    **parameters: float | Sequence[float | None] | None,
) -> Structure:
    """The same where a value may be missing, None or left out, alone or in a list: it is NaN in the chain.

    Of a measured structure nobody knows all; :func:`pinn_cli.scheme.missing_values.check_given` sees to it that only
    what is to be estimated is missing.
    """
    ndof = whole_number("system.ndof", ndof, least=1, most=MOST_DOFS)
    nonlinearity = _with_given(nonlinearity, parameters)
    names = (*LINEAR_UNITS, *nonlinearity.parameters)
    for name, value in parameters.items():
        if name not in names and (value is not None or name not in nonlinearity.optional):
            raise InputError(f"system.{name}", value, f"left out: a {nonlinearity.name} chain has {', '.join(names)}")
    if damping is not None and parameters.get("c") is None:
        parameters["c"] = 0.0
    values = {name: _per_connection(name, parameters.get(name), ndof) for name in names}
    _check_signs(values, nonlinearity)
    tensors = {name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()}
    return damped(chain_of(tensors, nonlinearity), damping)


def _with_given(nonlinearity: Nonlinearity, parameters: Mapping[str, Any]) -> Nonlinearity:
    return nonlinearity.of_given([name for name, value in parameters.items() if value is not None])


def _per_connection(name: str, value: Any, ndof: int) -> list[float]:
    if isinstance(value, np.ndarray | torch.Tensor):
        value = value.tolist()
    numbers = [value] * ndof if value is None or is_finite_number(value) else entries(value)
    if not numbers or not all(number is None or is_finite_number(number) for number in numbers):
        raise InputError(f"system.{name}", value, f"a finite number or a list of {ndof} finite numbers")
    for number in numbers:
        if number is not None and not is_usable_number(number):
            raise InputError(f"system.{name}", number, f"0 or {USABLE}")
    if len(numbers) != ndof:
        allowed = f"a number or a list of {ndof} numbers (system.ndof={ndof})"
        raise InputError(f"system.{name}", list(numbers), allowed, f"it has {len(numbers)}")
    return [math.nan if number is None else float(number) for number in numbers]


def _check_signs(values: dict[str, list[float]], nonlinearity: Nonlinearity) -> None:
    least = {
        name: min((number for number in row if not math.isnan(number)), default=1.0) for name, row in values.items()
    }
    if least["m"] <= 0.0:
        raise InputError("system.m", least["m"], "> 0", "a DOF without mass has no equation of motion")
    for name in nonlinearity.nonnegative:
        if least[name] < 0.0:
            raise InputError(f"system.{name}", least[name], ">= 0", "the connection would push itself apart")
