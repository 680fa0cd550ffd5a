"""The command that a look at a record proposes."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence

import numpy as np

from pinn_cli.record.response import GROUND
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.system.quantities import SUPPORT

# Samples per period of the highest frequency: what a run needs, and more than this are worth decimating.
NEEDED, PLENTY = 5.0, 12.0


def proposed_command(
    overrides: Sequence[str],
    signals: Sequence[Signal],
    sampling: Sampling,
    highest: float,
    frequencies: int,
    has_structure: bool,
) -> list[str]:
    """What to type next.

    Args:
        overrides: As typed, ``inspect`` apart.
        signals: All columns.
        sampling: Of their values.
        highest: Frequency of any channel's content, Hz.
        frequencies: Number of natural frequencies that were found.
        has_structure: Whether the structure's parameters were given.

    Returns:
        Words for a shell, those that need quotes in quotes; words in capitals are to be filled in.
    """
    known = [signal for signal in signals if signal.quantity]
    given = {setting_of(override) for override in overrides}
    told = any(f"data.{signal.quantity}" in {name.rpartition(".")[0] or name for name in given} | given
               for signal in known)  # fmt: skip
    added = [] if told else _assigned(known)
    added += _decimation(known or signals, sampling, highest)
    dofs = max((int(signal.place) for signal in known if signal.place.isdecimal()), default=0)
    if not has_structure:
        structure = {"system": "system=linear", "system.ndof": f"system.ndof={max(dofs, frequencies, 1)}"}
        added += [text for name, text in structure.items() if name not in given]
        if not any(name in given for name in ("system.m", "system.mass", "system.M")):
            added.append("system.m=MASS_IN_KG")
        if "scheme" not in given:
            added += ["scheme=state_parameter", "scheme.unknown=[k_*,c_*]"]
    kept = [override for override in overrides if setting_of(override) not in {setting_of(text) for text in added}]
    plain = (re.sub(r"^\+\+(?=[\w.]+=\{)", "", override) for override in (*kept, *added))
    return [shlex.quote(word) for word in ("pinn-run", *plain)]


def _assigned(signals: Sequence[Signal]) -> list[str]:
    """``data.acceleration={1: a1}``, the first column of a quantity and DOF alone."""
    places: dict[str, dict[str, str]] = {}
    for signal in (one for one in signals if one.quantity not in SUPPORT):
        places.setdefault(signal.quantity, {}).setdefault(str(int(signal.place or 0)), signal.column)
    words = {
        quantity: "{" + ", ".join(f"{dof}: {_quoted(column)}" for dof, column in columns.items()) + "}"
        for quantity, columns in places.items()
    }
    ground = places.get(GROUND)
    if ground:
        words[GROUND] = _quoted(next(iter(ground.values())))
    moved = [
        f"{_quoted(one.column)}: {{sensor: {SUPPORT[one.quantity]}, support: {one.place}}}"
        for one in signals
        if one.quantity in SUPPORT
    ]
    words |= {"channels": "{" + ", ".join(moved) + "}"} if moved else {}
    return [f"data.{quantity}={text}" for quantity, text in words.items()]


def _quoted(column: str) -> str:
    return column if re.fullmatch(r"[A-Za-z_][\w./-]*", column) else '"' + column.replace('"', r"\"") + '"'


def _decimation(signals: Sequence[Signal], sampling: Sampling, highest: float) -> list[str]:
    """Where no sample is missing: the filter needs all."""
    whole = not sampling.holes and all(np.isfinite(signal.values).all() for signal in signals)
    if not whole or not highest > 0.0 or sampling.rate < PLENTY * highest:
        return []
    return [f"data.decimate={int(sampling.rate / (NEEDED * highest))}"]
