"""What columns are, by their units and names, where nobody has said it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from pinn_cli.record.files.table import bare
from pinn_cli.record.response import GROUND, RESPONSE_QUANTITIES
from pinn_cli.record.signal import Signal

ACCELERATION, FORCE = RESPONSE_QUANTITIES[2], "force"
# What is measured in a unit.
_LENGTH = r"(?:[munkc]?m|in|ft|mil)"
_UNITS = (
    (ACCELERATION, re.compile(rf"[mu]?g|g_?n|m?[Gg]al|{_LENGTH}\s*(?:/\s*s\s*(?:\^?2|\*\*2|/\s*s)|\s\^?s\^?-2)")),
    ("velocity", re.compile(rf"{_LENGTH}\s*/\s*s")),
    ("displacement", re.compile(_LENGTH)),
    (FORCE, re.compile(r"[mkM]?N|lbf?|kip|kgf")),
)
# What columns are called.
_NAMES = (
    (GROUND, re.compile(r"ground|base|table|\bag\b|ugdd|boden|fundament", re.IGNORECASE)),
    (FORCE, re.compile(r"^(f|p)\W*\d*\b|^f[a-z]?\d|forc|load|hammer|shaker|kraft", re.IGNORECASE)),
    (ACCELERATION, re.compile(r"^a\W*\d*\b|^a[a-z]?\d|acc|beschl|udd", re.IGNORECASE)),
    ("velocity", re.compile(r"^v\W*\d*\b|^v[a-z]?\d|vel|geschw", re.IGNORECASE)),
    ("displacement", re.compile(r"^(u|d|x|y)\W*\d*\b|^[ud][a-z]?\d|disp|lvdt|laser|weg|verschieb", re.IGNORECASE)),
)
# What is numbered as channels are, not as DOFs.
_CHANNELS = re.compile(r"(^|[\W_])(ch|chan|channel|kanal|ai|input|sensor)\W*#", re.IGNORECASE)
# A number beyond this is that of a channel or a node.
_MOST_DOFS = 50


def guessed(signals: Sequence[Signal]) -> tuple[list[Signal], list[str]]:
    """The same with quantity and DOF, and what is to be said of that; both empty where somebody has said what one is.

    A unit goes before a name. Where neither says anything, all columns are taken for accelerations. DOFs are the
    numbers in the names, unless these are numbers of channels: then the columns of a quantity are counted.
    """
    if any(signal.quantity for signal in signals):
        return [], []
    notes = ["what columns are is guessed by their names and units: see the command below"]
    quantities = [_quantity(signal) for signal in signals]
    if not any(quantity in RESPONSE_QUANTITIES for quantity in quantities):
        left = [i for i, quantity in enumerate(quantities) if not quantity]
        for i in left:
            quantities[i] = ACCELERATION
        notes = ["nothing says what the columns measure: they are taken for accelerations in m/s^2"] if left else notes
    numbers = [number_of(signal) for signal in signals]
    stems = {re.sub(r"\d+", "#", bare(signal.column)): set[str]() for signal in signals}
    for signal, quantity in zip(signals, quantities, strict=True):
        stems[re.sub(r"\d+", "#", bare(signal.column))].add(quantity)
    channels = any(len(of_stem - {""}) > 1 or _CHANNELS.search(stem) for stem, of_stem in stems.items())
    places, counted = [""] * len(signals), False
    for quantity in (*RESPONSE_QUANTITIES, FORCE):
        own = [i for i, one in enumerate(quantities) if one == quantity]
        named = [numbers[i] for i in own]
        if channels or len(set(named)) < len(named) or (None in named and len(named) > 1) or not _are_dofs(named):
            named, counted = list(range(1, len(own) + 1)), counted or len(own) > 1
        for i, number in zip(own, named, strict=True):
            places[i] = str(number or 1)
    if counted:
        notes.append("which DOF a column belongs to is not in its name: they are counted as they stand in the file")
    found = zip(signals, quantities, places, strict=True)
    return [replace(signal, quantity=quantity, place=place) for signal, quantity, place in found], notes


def quantity_of_unit(unit: str) -> str:
    """What is measured in a unit; "": nothing that is known here."""
    return next((quantity for quantity, pattern in _UNITS if pattern.fullmatch(unit)), "")


def _quantity(signal: Signal) -> str:
    of_unit = quantity_of_unit(signal.unit)
    parts = [signal.column, *reversed(re.split(r"[/.]", signal.column))]
    of_name = next((quantity for part in parts for quantity, name in _NAMES if name.search(part.strip())), "")
    return GROUND if of_name == GROUND and of_unit in ("", ACCELERATION) else of_unit or of_name


def number_in(column: str) -> int | None:
    """In the name of a column, that of its last part that has one."""
    parts = reversed(re.split(r"[/.]", bare(column)))
    found = next((match for part in parts if (match := re.search(r"\d+", part))), None)
    return None if found is None else int(found[0])


def number_of(signal: Signal) -> int | None:
    """That of the place, else that in the name."""
    found = re.search(r"\d+", signal.place)
    return number_in(signal.column) if found is None else int(found[0])


def _are_dofs(numbers: Sequence[int | None]) -> bool:
    return all(number is None or 1 <= number <= _MOST_DOFS for number in numbers)
