"""The settings that a look at a record proposes: a run with them goes as it is."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.settings.override_syntax import is_plain, setting_of, text_value
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT

# Samples per period of the highest frequency: what a run needs, and more than this are worth decimating.
NEEDED, PLENTY = 5.0, 12.0
# The options of a command that chooses none.
_DEFAULTS = {"system": "duffing", "scheme": "sparse_recovery"}
# Settings that say what the masses are.
_MASSES = ("m", "mass", "M")
_PER_MASS = (
    "no force was measured, so no mass can be found: system.m=1 is taken, and stiffness and damping come out per kg of"
    " mass; system.m=... in kg, a number or one per DOF, gives N/m and N s/m"
)
_NO_SENSOR = (
    "no column is a sensor of the motion, and an estimate needs one: data.displacement, data.velocity or"
    " data.acceleration; to shake a simulated structure with a ground's record: excitation=ground_motion"
)
_MASSES_TOO = "masses are unknown, too, and the measured force tells them; if you know them, give system.m=... in kg"


@dataclass(frozen=True)
class Said:
    """What the command that looked at the record said.

    Attributes:
        overrides: As typed, ``inspect`` apart.
        options: Words before them, such as ``--config-dir``.
        time: A column that nobody has called times, and that has them; "": there is none.
        chosen: Group to option, those of files too.
        settings: Of ``data`` and ``system``, as composed.
    """

    overrides: Sequence[str] = ()
    options: Sequence[str] = ()
    time: str = ""
    chosen: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def in_memory(self) -> bool:
        """Whether the record is in that of a Python program."""
        return self.chosen.get("data") == "frame"

    def names(self, *settings: str) -> bool:
        """Whether one of some settings, or a part of it, was typed."""
        given = [setting_of(override) for override in self.overrides]
        return any(name == setting or name.startswith(f"{setting}.") for name in given for setting in settings)

    def chooses(self, group: str) -> bool:
        """Whether an option of a group was typed, or is that of a file."""
        return self.names(group) or self.chosen.get(group, _DEFAULTS[group]) != _DEFAULTS[group]

    @property
    def thins(self) -> bool:
        """Whether fewer samples were asked for."""
        data = self.settings.get("data") or {}
        return self.names("data.decimate") or data.get("decimate", 1) != 1 or data.get("band") is not None

    def has(self, group: str, *names: str) -> bool:
        """Whether one of some settings of a group has a value."""
        values = self.settings.get(group) or {}
        return self.names(*(f"{group}.{name}" for name in names)) or any(values.get(name) for name in names)


@dataclass(frozen=True)
class Look:
    """What a look at the record has found that a command depends on.

    Attributes:
        signals: All columns.
        sampling: Of their values.
        highest: Frequency of any channel's content, Hz.
        frequencies: Number of natural frequencies that were found.
        has_structure: Whether the structure's parameters were given.
        guessed: Whether it was guessed what columns are.
        offsets: Columns that have one.
        strange: Columns whose unit is none of what they measure.
    """

    signals: Sequence[Signal]
    sampling: Sampling
    highest: float
    frequencies: int
    has_structure: bool
    guessed: bool = False
    offsets: Collection[str] = ()
    strange: Collection[str] = ()

    @property
    def identified(self) -> list[Signal]:
        """The columns of which it is known what they are."""
        return [signal for signal in self.signals if signal.quantity]

    @property
    def dofs(self) -> set[int]:
        """Those with a sensor or a force, counted from 1."""
        return {
            int(signal.place)
            for signal in self.identified
            if signal.place.isdecimal() and signal.quantity not in SUPPORT
        }


def proposed_settings(said: Said, look: Look) -> tuple[list[str], list[str]]:
    """What to run next: overrides, and sentences that stand beside them."""
    added = [f"data.time={text_value(said.time)}"] if said.time else []
    added += _assigned(look) if look.guessed else _with_offsets(said, look)
    structure, remarks, ndof = ([], [], 0) if look.has_structure else _structure(said, look)
    data = said.settings.get("data") or {}
    # Something that acts is measured, or said to act unmeasured.
    is_said = bool(data.get("force") or data.get(GROUND)) or said.names("data.force")
    is_driven = is_said or any(signal.is_input for signal in look.identified)
    if not look.has_structure and not is_driven:
        added.append("data.force={" + ", ".join(f"{dof}: null" for dof in range(1, ndof + 1)) + "}")
    added += [] if said.thins else _decimation(look)
    added += structure
    replaced = {setting_of(text) for text in added}
    kept = [override for override in said.overrides if setting_of(override) not in replaced]
    plain = [re.sub(r"^\+\+(?=[\w.]+=\{)", "", override) for override in (*kept, *added)]
    if look.identified and all(signal.is_input for signal in look.identified):
        remarks = [_NO_SENSOR]
    if said.in_memory:  # whose name is of no use to anybody: data=... is an argument
        plain = [override for override in plain if setting_of(override) not in ("data", "data.path")]
    return plain, remarks


def _structure(said: Said, look: Look) -> tuple[list[str], list[str], int]:
    """Settings of the structure and of what is unknown, sentences about them, and the number of DOFs."""
    added, remarks = [], []
    ndof = _ndof(said, look)
    if not said.chooses("system"):
        added.append("system=linear")
    elif said.chosen.get("system", "linear") == "modal":
        return [], [], ndof
    by_file = said.chooses("system") and not said.names("system")  # which says its size as well
    if not (by_file or said.names("system.ndof") or said.chosen.get("system") in ("structure", "matrices")):
        added.append(f"system.ndof={ndof}")
    kinds = [kind for kind in ("k", "c") if not said.has("system", kind)]
    kinds = [kind for kind in kinds if kind != "c" or not said.has("system", "damping")]
    if not said.has("system", *_MASSES) and said.chosen.get("system") not in ("structure", "matrices"):
        if any(signal.quantity == FORCE for signal in look.identified):
            kinds, remarks = ["m", *kinds], [_MASSES_TOO]
        else:
            added.append("system.m=1")
            remarks = [_PER_MASS]
    if not said.chooses("scheme"):
        unknown = ",".join(f"{kind}_*" for kind in kinds)
        is_linear = "system=linear" in (*added, *said.overrides) or said.chosen.get("system") == "linear"
        added += ["scheme=state_parameter", f"scheme.unknown=[{unknown}]" if is_linear else "scheme.unknown=missing"]
    return added, remarks, ndof


def _ndof(said: Said, look: Look) -> int:
    """As given; as many as have sensors, where these are the first ones; else also as natural frequencies."""
    given = next(
        (override.partition("=")[2] for override in said.overrides if setting_of(override) == "system.ndof"), ""
    )
    given = given or str((said.settings.get("system") or {}).get("ndof", "")) * said.chooses("system")
    if given.isdecimal():
        return int(given)
    dofs = look.dofs
    all_there = len(dofs) > 1 and len(dofs) == max(dofs)
    return max(dofs, default=1) if all_there else max(*dofs, look.frequencies, 1)


def _assigned(look: Look) -> list[str]:
    """``data.acceleration={1: a1}``, the first column of a quantity and DOF alone, and ``data.channels`` for others."""
    places: dict[str, dict[str, str]] = {}
    for signal in (signal for signal in look.identified if signal.quantity not in SUPPORT):
        if not _is_special(signal, look):
            places.setdefault(signal.quantity, {}).setdefault(str(int(signal.place or 0)), signal.column)
    words = {
        quantity: "{" + ", ".join(f"{dof}: {text_value(column)}" for dof, column in columns.items()) + "}"
        for quantity, columns in places.items()
    }
    if GROUND in places:
        words[GROUND] = text_value(next(iter(places[GROUND].values())))
    special = [_channel(signal, look) for signal in look.identified if _is_special(signal, look)]
    words |= {"channels": "{" + ", ".join(special) + "}"} if special else {}
    return [f"data.{quantity}={text}" for quantity, text in words.items()]


def _with_offsets(said: Said, look: Look) -> list[str]:
    """What was typed of accelerations, where one has an offset that nobody has said; nothing otherwise."""
    typed, others = said.names("data.acceleration"), said.names("data.channels")
    if not typed or others or not look.offsets:
        return []
    settings = [text for text in _assigned(look) if setting_of(text) in ("data.acceleration", "data.channels")]
    has_map = any(setting_of(text) == "data.acceleration" for text in settings)
    return settings if has_map else [*settings, "data.acceleration={}"]


def _is_special(signal: Signal, look: Look) -> bool:
    return signal.quantity in SUPPORT or signal.column in (*look.offsets, *look.strange)


def _channel(signal: Signal, look: Look) -> str:
    """An entry of ``data.channels``, under a name that needs no quotes: Hydra's grammar takes none around a key."""
    name = signal.column if is_plain(signal.column) else re.sub(r"\W+", "_", signal.column, flags=re.ASCII)
    parts = [f"sensor: {SUPPORT.get(signal.quantity, signal.quantity)}"]
    parts += [] if name == signal.column else [f"column: {text_value(signal.column)}"]
    if signal.quantity != GROUND:
        parts.append(f"{'support' if signal.quantity in SUPPORT else 'dof'}: {signal.place}")
    parts += ["unit: 1"] if signal.column in look.strange else []
    parts += ["offset: unknown"] if signal.column in look.offsets else []
    return f"{name.strip('_') or 'channel'}: {{{', '.join(parts)}}}"


def _decimation(look: Look) -> Iterator[str]:
    """Where no sample is missing: the filter needs all."""
    signals, sampling, highest = look.identified or look.signals, look.sampling, look.highest
    whole = not sampling.holes and all(np.isfinite(signal.values).all() for signal in signals)
    if whole and highest > 0.0 and sampling.rate >= PLENTY * highest:
        yield f"data.decimate={int(sampling.rate / (NEEDED * highest))}"
