"""Names of DOFs in settings: a structure whose coordinates have names takes those wherever a DOF is asked for."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.records import of_record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_whole_number
from pinn_cli.settings.suggestion import suggestion

if TYPE_CHECKING:
    from pinn_cli.record.record import Measurements, Record
    from pinn_cli.system.parameters import Labels

# Settings that are a map whose keys are DOFs, and those that are a list of DOFs.
OF_DATA = ("force", "displacement", "velocity", "acceleration")
MAPS = tuple(f"{group}.{name}" for group in ("data", "data.validation") for name in OF_DATA)
# What stands for the support among the ends of a channel.
GROUND_NAMES = ("ground", 0)
# Of simulated records alone: a measured one has the sensors that it has.
SIMULATED = "scheme.unobserved"
LISTS = ("data.holdout", "excitation.dofs", "excitation.force.dofs", "scheme.unobserved", "validation.dofs")


def numbered(config: DictConfig, labels: Labels) -> DictConfig:
    """The configuration with the number, from 1, of every DOF that it names; as it is where DOFs have no names.

    Args:
        config: Of the run, without interpolations.
        labels: Of the structure.

    Raises:
        InputError: Naming the setting: there is no such DOF, or it is there twice.
    """
    if not labels.dofs:
        return config
    plain: Any = OmegaConf.to_container(config)
    measured = "path" in (plain.get("data") or {})
    for setting in (*MAPS, *LISTS):
        if measured and setting == SIMULATED:
            continue  # its default is of the paper's chain; what a user says is refused by what reads it
        _number_setting(plain, setting, labels)
    data = plain.get("data")
    _number_channels("data", data, labels)
    _number_channels("data.validation", data.get("validation") if isinstance(data, dict) else None, labels)
    records = data.get("records") if isinstance(data, dict) else None
    entries = records if isinstance(records, list) else []
    for i, entry in enumerate(entries, start=1):
        with of_record(i, len(entries)):
            for setting in (name for name in (*MAPS, *LISTS) if name.startswith("data.") and "validation" not in name):
                _number_setting({"data": entry}, setting, labels)
            _number_channels("data", entry, labels)
    return OmegaConf.create(plain)


def _number_setting(plain: dict[str, Any], setting: str, labels: Labels) -> None:
    """Put numbers in the place of the names in one setting, if it is there."""
    *groups, last = setting.split(".")
    node: Any = plain
    for group in groups:
        node = node.get(group) if isinstance(node, dict) else None
    if not isinstance(node, dict) or not isinstance(node.get(last), dict if setting in MAPS else list):
        return  # what is something else is refused by what reads it
    given = node[last]
    numbers = [_number(setting, dof, labels) for dof in given]
    for i, number in enumerate(numbers):
        if setting in MAPS and number in numbers[:i]:
            raise InputError(setting, labels.dofs[number - 1], "there once only", "by its name or by its number")
    node[last] = dict(zip(numbers, given.values(), strict=True)) if setting in MAPS else numbers


def _number_channels(group: str, data: Any, labels: Labels) -> None:
    """Give the DOFs in the long form of channels, ``data.channels``, their numbers."""
    channels = data.get("channels") if isinstance(data, dict) else None
    if not isinstance(channels, dict):
        return
    for name, given in channels.items():
        if not isinstance(given, dict):
            continue  # refused by what reads it
        setting = f"{group}.channels.{name}"
        channel = given
        if isinstance(given.get("sensor"), dict):  # of a class, which takes long to import
            from pinn_cli.record.own_sensor import as_channel

            channel = channels[name] = dict(as_channel(setting, given))
        if channel.get("support") is not None:
            channel["support"] = _support(f"{setting}.support", channel["support"], labels.supports)
        if channel.get("dof") is not None:
            channel["dof"] = _number(f"{setting}.dof", channel["dof"], labels)
        if isinstance(channel.get("between"), list):
            ends = channel["between"]
            channel["between"] = [e if e in GROUND_NAMES else _number(f"{setting}.between", e, labels) for e in ends]
        if isinstance(channel.get("weights"), dict):
            weights = channel["weights"].items()
            channel["weights"] = {_number(f"{setting}.weights", dof, labels): weight for dof, weight in weights}


def named(measure: Callable[[Any], Measurements], of: object, labels: Labels) -> Measurements:
    """What ``measure`` makes of something, its record's DOFs with the names that the user has given them."""
    with in_names(labels):
        measured = measure(of)
    return replace(measured, record=described(measured.record, labels))


def described(record: Record, labels: Labels) -> Record:
    """A record with the names of the structure's DOFs and supports.

    Raises:
        InputError: Of a support that moves nothing was measured, or there is no such support.
    """
    import numpy as np

    names, measured = labels.supports, np.zeros(len(labels.supports), dtype=bool)
    supports = {}
    for quantity, values in record.supports.items():
        if values.shape[1] > len(names):
            hint = "system.supports names the supports that move"
            raise InputError("data.channels", f"support {values.shape[1]}", "one that the structure has", hint)
        supports[quantity] = np.pad(values, ((0, 0), (0, len(names) - values.shape[1])), constant_values=np.nan)
        measured |= np.isfinite(supports[quantity][0])
    if not measured.all():
        name = names[int(np.argmin(measured))]
        hint = f"data.channels={{{name}: {{sensor: displacement, support: {name}}}}}; one at rest is ground"
        raise InputError("system.supports", name, "one with a channel of its motion", hint)
    return replace(record, dofs=labels.dofs, supports=supports, support_names=names)


def _support(setting: str, given: object, names: tuple[str, ...]) -> int:
    """Number of a support, from 1."""
    if given in names:
        return names.index(str(given)) + 1
    if is_whole_number(given) and 1 <= given <= len(names):  # type: ignore[operator]
        return int(given)  # type: ignore[call-overload]
    allowed = f"one of system.supports: {', '.join(names)}" if names else "left out: system.supports names none"
    raise InputError(setting, given, allowed, suggestion(str(given), names))


@contextmanager
def in_names(labels: Labels) -> Iterator[None]:
    """Errors about `data.acceleration.3` name the DOF as the user does, within the block."""
    try:
        yield
    except InputError as error:
        known = rf"({'|'.join(map(re.escape, MAPS))})\.(\d+)"
        match = re.fullmatch(known, error.setting)
        if match is None or not labels.dofs or not 1 <= int(match[2]) <= len(labels.dofs):
            raise
        setting = f"{match[1]}.{labels.dofs[int(match[2]) - 1]}"
        raise InputError(setting, error.value, error.allowed, error.hint) from None


def _number(setting: str, dof: object, labels: Labels) -> int:
    names, count = labels.dofs, len(labels.dofs)
    if isinstance(dof, str) and dof in names:
        return names.index(dof) + 1
    number = int(dof) if isinstance(dof, str) and dof.isdecimal() else dof
    if is_whole_number(number) and 1 <= number <= count:  # type: ignore[operator]
        return int(number)  # type: ignore[call-overload]
    allowed = f"one of the DOFs {', '.join(names)}, or its number from 1 to {count}"
    raise InputError(setting, dof, allowed, suggestion(str(dof), names))
