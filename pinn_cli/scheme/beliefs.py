"""Parameters that the user believes in, but for a few per cent."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_finite_number
from pinn_cli.system.parameters import MASS, Parameter
from pinn_cli.system.structure import Structure

# Of a standard deviation over the value: beyond it nothing is believed, and sums lose their last digits.
LARGEST_UNCERTAINTY = 1000


def checked_uncertainty(value: Any) -> float:
    """``scheme.parameter_uncertainty`` as a number.

    Raises:
        InputError: It is none, negative, or so large that nothing is believed.
    """
    if not is_finite_number(value) or not 0 <= value <= LARGEST_UNCERTAINTY:
        allowed = f"a number between 0 and {LARGEST_UNCERTAINTY}"
        raise InputError("scheme.parameter_uncertainty", value, allowed, "0 holds the parameters fixed")
    return float(value)


def believed_parameters(
    structure: Structure, uncertainty: float, but: Collection[Parameter] = ()
) -> tuple[Parameter, ...]:
    """Every parameter of a chain but its masses, with a relative prior standard deviation.

    Args:
        structure: The prescribed model.
        uncertainty: The standard deviation over the value; 0 leaves every parameter fixed.
        but: Parameters that are left out.
    """
    return tuple(
        replace(parameter, prior_std=uncertainty * abs(parameter.prescribed))
        for parameter in structure.every_parameter()
        if parameter.kind != MASS and parameter not in but and uncertainty * parameter.prescribed != 0
    )
