"""Units of channels, by pint's names, as factors to SI units."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import NUMERAL, positive_number
from pinn_cli.system.quantities import GROUND, MOTION, SUPPORT, UNITS

if TYPE_CHECKING:
    from pint import UnitRegistry

# Of an accelerometer g is no gram, and Gal no gallon.
GRAVITY_UNITS = {"g": "g_0", "mg": "mg_0", "ug": "ug_0", "gal": "Gal", "mgal": "mGal"}


def si_factor(setting: str, unit: Any, quantity: str) -> float:
    """How many SI units of a quantity one of a unit is.

    Args:
        setting: Whose unit it is, for errors.
        unit: A name or an expression as pint reads it, ``mm``, ``kN``, ``m/s^2``; ``g`` of an acceleration; a number is
            the factor itself; None: SI.
        quantity: That the channel measures.

    Raises:
        InputError: An unknown unit, or one of another quantity.
    """
    accelerates = SUPPORT.get(quantity, quantity) in (MOTION[2], GROUND)
    if accelerates and isinstance(unit, str):
        unit = GRAVITY_UNITS.get(unit.strip(), unit)
    return factor(setting, unit, UNITS[quantity], quantity)


def factor(setting: str, unit: Any, base_unit: str, sensor: str) -> float:
    """How many of ``base_unit`` one unit of a sensor, called so, is; see :func:`si_factor`."""
    if unit is None or unit == base_unit:
        return 1.0
    if isinstance(unit, int | float) and not isinstance(unit, bool):
        return float(positive_number(setting, unit))
    allowed = f"a unit such as {base_unit}, or the number of {base_unit} that one is"
    if not isinstance(unit, str) or not unit.strip():
        raise InputError(setting, unit, allowed)
    if NUMERAL.fullmatch(unit.strip()):
        return float(positive_number(setting, float(unit)))
    import pint

    try:
        quantity = _registry().Quantity(1.0, unit)
    except (pint.errors.PintError, ValueError, TypeError, AttributeError, SyntaxError, AssertionError) as error:
        first = str(error).splitlines()[0] if str(error) else "pint cannot read it"
        raise InputError(setting, unit, allowed, first) from None
    try:
        return float(quantity.to(base_unit).magnitude)
    except pint.errors.PintError:
        meaning = f"[{quantity.units:~}]" if quantity.dimensionless else quantity.dimensionality
        hint = f"{unit} measures {meaning}, and the channel's sensor is one of {sensor}"
        raise InputError(setting, unit, allowed, hint) from None


@cache
def _registry() -> UnitRegistry[Any]:
    """Made once, and only where a channel has a unit of its own: it takes half a second."""
    import pint

    return pint.UnitRegistry()
