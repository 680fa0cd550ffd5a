"""Which DOFs have sensors, as a user says it: a fraction, a pattern or a list."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, is_whole_number
from pinn_cli.system.quantities import FORCE

PATTERN = re.compile(r"every_(\d+)(?:st|nd|rd|th)")


def unobserved_dofs(ndof: int, fraction: float, unobserved: str | Sequence[int] | None) -> list[int]:
    """DOFs without response sensors, counted from 1.

    Args:
        ndof: Number of DOFs.
        fraction: b_r; without ``unobserved`` the last round(b_r n) DOFs are unobserved (domain extension; paper,
            section 4.1).
        unobserved: A list of DOFs, or ``every_2nd``, ``every_3rd``, ...: every second, third, ... DOF is unobserved
            (interpolation).

    Raises:
        InputError: Any of them outside what is possible, or nothing left to observe.
    """
    if unobserved is None:
        if not is_finite_number(fraction) or not 0 <= fraction < 1:
            raise InputError("scheme.unobserved_fraction", fraction, "a number from 0 to below 1")
        hidden = round(fraction * ndof)
        if hidden == ndof:
            hint = f"{fraction} of {ndof} DOFs rounds to all of them"
            raise InputError("scheme.unobserved_fraction", fraction, "less, so that one DOF stays observed", hint)
        return list(range(ndof - hidden + 1, ndof + 1))
    if isinstance(unobserved, str):
        dofs = _pattern(unobserved, ndof)
    else:
        dofs = entries(unobserved)
        if not all(is_whole_number(dof) and 1 <= dof <= ndof for dof in dofs):
            hint = "DOFs are counted from 1 at the fixed end"
            raise InputError("scheme.unobserved", list(unobserved), f"DOFs from 1 to {ndof}", hint)
    if len(set(dofs)) == ndof:
        hint = "an estimator needs one observed DOF"
        raise InputError("scheme.unobserved", unobserved, f"fewer than all {ndof} DOFs", hint)
    return sorted(set(dofs))


@dataclass(frozen=True)
class Sensors:
    """Of a simulated record.

    Attributes:
        quantities: Of the response that every observed DOF has a sensor for.
        load_cells: Whether forced DOFs have one.
        fraction, unobserved: Which DOFs are not observed, see :func:`unobserved_dofs`.
    """

    quantities: tuple[str, ...]
    load_cells: bool
    fraction: float
    unobserved: str | Sequence[int] | None

    @classmethod
    def chosen(
        cls,
        sensors: Mapping[str, bool] | None,
        fraction: float,
        unobserved: str | Sequence[int] | None,
        default: Sequence[str] = ("acceleration",),
    ) -> Sensors:
        """As a scheme's settings say; of ``default`` quantities where they name none.

        Raises:
            InputError: See :func:`sensor_quantities`.
        """
        quantities = sensor_quantities(dict.fromkeys(default, True) if sensors is None else sensors)
        return cls(quantities, has_load_cells(sensors or {}), fraction, unobserved)

    def observe(self, record: Record) -> Record:
        """See :meth:`pinn_cli.scheme.scheme.Scheme.observe`."""
        hidden = unobserved_dofs(record.ndof, self.fraction, self.unobserved)
        observed = [dof for dof in range(1, record.ndof + 1) if dof not in hidden]
        kept = record.keep(dict.fromkeys(self.quantities, observed))
        return kept if self.load_cells else kept.without_load_cells()


def _pattern(text: str, ndof: int) -> list[int]:
    match = PATTERN.fullmatch(text)
    if match is None or int(match[1]) < 2:
        raise InputError("scheme.unobserved", text, "null, a list of DOFs, or a pattern such as every_2nd or every_3rd")
    return list(range(int(match[1]), ndof + 1, int(match[1])))


def sensor_quantities(sensors: Mapping[str, bool]) -> tuple[str, ...]:
    """The response quantities that observed DOFs have sensors for.

    Raises:
        InputError: An unknown quantity, or none chosen.
    """
    for name, chosen in sensors.items():
        if name not in (*RESPONSE_QUANTITIES, FORCE) or not isinstance(chosen, (bool, np.bool_)):
            allowed = f"true or false for each of {', '.join((*RESPONSE_QUANTITIES, FORCE))}"
            raise InputError(f"scheme.sensors.{name}", chosen, allowed)
    quantities = tuple(q for q in RESPONSE_QUANTITIES if sensors.get(q, False))
    if not quantities:
        allowed = "at least one of displacement, velocity, acceleration set to true"
        raise InputError("scheme.sensors", dict(sensors), allowed)
    return quantities


def has_load_cells(sensors: Mapping[str, bool]) -> bool:
    """Whether forced DOFs have load cells: unless ``force`` is false."""
    return bool(sensors.get(FORCE, True))
