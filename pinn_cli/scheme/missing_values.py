"""What of a measured structure has no value: the scheme has to be told that it is unknown."""

from __future__ import annotations

import math
from collections.abc import Collection

from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure


def check_given(prescribed: Structure, unknown: Collection[Parameter] = ()) -> None:
    """See that every parameter has a value or is unknown.

    Args:
        prescribed: As the user configured it; NaN where there is no value.
        unknown: What is to be estimated from the record.

    Raises:
        InputError: Naming ``system.<kind>`` of what is neither given nor unknown.
    """
    missing: dict[str, list[str]] = {}
    for parameter in prescribed.every_parameter():
        if parameter not in unknown and math.isnan(parameter.prescribed):
            missing.setdefault(parameter.kind, []).append(parameter.name)
    if not missing:
        return
    settings = ", ".join(f"system.{kind}" for kind in missing)
    units = ", ".join(f"{kind} in {prescribed.units[kind]}" for kind in missing)
    names = ", ".join(_shown(names) for names in missing.values())
    raise InputError(
        settings,
        "(nothing)",
        f"your structure's own, each a number or a list of {prescribed.ndof} ({units})",
        f"a measured record takes no value of the demonstration's. If {names} are unknown, name them in scheme.unknown"
        " of scheme=state_parameter or bayesian",
    )


def _shown(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}" if len(names) > 2 else ", ".join(names)
