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
    missing: dict[str, list[Parameter]] = {}
    for parameter in prescribed.every_parameter():
        if parameter not in unknown and math.isnan(parameter.prescribed):
            missing.setdefault(parameter.kind, []).append(parameter)
    if not missing:
        return
    all_missing = [parameter for parameters in missing.values() for parameter in parameters]
    settings = ", ".join(dict.fromkeys(prescribed.labels.setting(parameter) for parameter in all_missing))
    units = ", ".join(dict.fromkeys(f"{p.kind} in {p.unit}" for p in all_missing))
    named = bool(prescribed.labels.connections)
    names = ", ".join(_shown([p.name for p in ps], named) for ps in missing.values())
    given = "a number" if named else f"a number or a list of {prescribed.ndof}"
    of_whole = "c" in missing and not prescribed.supports
    whole = "; system.damping={ratio: 0.02} says it of the whole, without a c" if of_whole else ""
    raise InputError(
        settings,
        "(nothing)",
        f"your structure's own, each {given} ({units})",
        f"a measured record takes no value of the demonstration's. If {names} are unknown, name them in scheme.unknown"
        f" of scheme=state_parameter or bayesian{whole}",
    )


def _shown(names: list[str], named: bool) -> str:
    """Numbered parameters as a range; those that have names of their own one by one."""
    if named:
        return ", ".join(names)
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}" if len(names) > 2 else ", ".join(names)
