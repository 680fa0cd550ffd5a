"""Settings of records: what each entry of `data.records` says, and DOFs by the names that a structure gives them.

A structure whose coordinates have names takes those wherever a DOF is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import is_whole_number

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.system.parameters import Labels

RECORDS_SETTING = "data.records"
# What all records have in common.
COMMON_SETTINGS = ("_target_", "kind", "format", "records", "validation", "window", "overlap")
# Of these, what is said of the run, not of a record.
OF_THE_RUN = ("window", "overlap")
# Settings of data that are a map whose keys are DOFs, and other settings that are a list of DOFs.
OF_DATA = ("force", "displacement", "velocity", "acceleration")
LISTS = ("excitation.dofs", "excitation.force.dofs", "scheme.unobserved", "validation.dofs")
# What stands for the support among the ends of a channel.
GROUND_NAMES = ("ground", 0)


def data_of_records(data: DictConfig) -> list[DictConfig]:
    """The settings `data` of every record: those of its entry, and of `data` itself what the entry does not name.

    A map of columns is the entry's own as a whole: where it names an accelerometer, it has no other ones.

    Raises:
        InputError: Naming `data.records`: it is no list of maps, or an entry names what is no setting of a record.
    """
    plain: Any = OmegaConf.to_container(data)
    entries = plain.pop("records", None)
    for name in OF_THE_RUN:
        plain.pop(name, None)
    if entries is None or entries == []:
        return [OmegaConf.create(plain)]
    if not isinstance(entries, list):
        allowed = "a list of maps, one for each record, such as [{path: a.csv}, {path: b.csv}]"
        raise InputError(RECORDS_SETTING, entries, allowed)
    for number, entry in enumerate(entries, start=1):
        _check_entry(entry, f"record {number}: {RECORDS_SETTING}", plain)
    return [OmegaConf.create(plain | entry) for entry in entries]


def _check_entry(entry: Any, setting: str, data: Mapping[str, Any]) -> None:
    if not isinstance(entry, dict) or not entry:
        raise InputError(setting, entry, "a map of settings, such as {path: a.csv}")
    names = [name for name in data if name not in COMMON_SETTINGS]
    for name in entry:
        if name not in names:
            hint = f"{name} is the same for all records" if name in COMMON_SETTINGS else suggestion(str(name), names)
            raise InputError(setting, name, f"one of {', '.join(names)}", hint)


@contextmanager
def of_record(number: int, records: int) -> Iterator[None]:
    """Errors say which of several records they are about, within the block; records are counted from 1."""
    try:
        yield
    except InputError as error:
        if records == 1:
            raise
        raise InputError(f"record {number}: {error.setting}", error.value, error.allowed, error.hint) from None


def numbered(config: DictConfig, labels: Labels) -> DictConfig:
    """The configuration with the number, from 1, of every DOF that it names; as it is where DOFs have no names.

    It has no interpolations. What is no list or map is left to what reads it.

    Raises:
        InputError: Naming the setting: there is no such DOF, or it is there twice.
    """
    if not labels.dofs:
        return config
    plain: Any = OmegaConf.to_container(config)
    data: Any = plain.get("data") if isinstance(plain.get("data"), dict) else {}
    for setting in LISTS:
        if setting == "scheme.unobserved" and "path" in data:
            continue  # of simulated records alone: its default is of the paper's chain
        *groups, last = setting.split(".")
        node: Any = plain
        for group in groups:
            node = node.get(group) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(last), list):
            node[last] = [_dof(setting, dof, labels) for dof in node[last]]
    records: Any = data.get("records")
    entries = records if isinstance(records, list) else []
    nodes = [(0, "data", data), (0, "data.validation", data.get("validation"))]
    for number, group, node in [*nodes, *((i, "data", entry) for i, entry in enumerate(entries, start=1))]:
        if isinstance(node, dict):
            with of_record(number, len(entries)) if number else nullcontext():
                _number_data(group, node, labels)
    return OmegaConf.create(plain)


def _number_data(group: str, data: dict[str, Any], labels: Labels) -> None:
    """Put numbers in the place of the names in the settings of one record."""
    if isinstance(data.get("holdout"), list):
        data["holdout"] = [_dof(f"{group}.holdout", dof, labels) for dof in data["holdout"]]
    for quantity in OF_DATA:
        columns = data.get(quantity)
        if isinstance(columns, dict):
            data[quantity] = {}
            for dof, column in columns.items():
                number = _dof(f"{group}.{quantity}", dof, labels)
                if number in data[quantity]:
                    given, hint = labels.dofs[number - 1], "by its name or by its number"
                    raise InputError(f"{group}.{quantity}", given, "there once only", hint)
                data[quantity][number] = column
    channels: Any = data.get("channels")
    for name, given in channels.items() if isinstance(channels, dict) else ():
        if isinstance(given, dict):
            channels[name] = _numbered_channel(f"{group}.channels.{name}", given, labels)


def _numbered_channel(setting: str, channel: dict[str, Any], labels: Labels) -> dict[str, Any]:
    if isinstance(channel.get("sensor"), dict):  # of a class, which takes long to import
        from pinn_cli.record.own_sensor import as_channel

        channel = dict(as_channel(setting, channel))
    if channel.get("support") is not None:
        names = labels.supports
        allowed = f"one of system.supports: {', '.join(names)}" if names else "left out: system.supports names none"
        channel["support"] = _number(f"{setting}.support", channel["support"], names, allowed)
    if channel.get("dof") is not None:
        channel["dof"] = _dof(f"{setting}.dof", channel["dof"], labels)
    if isinstance(channel.get("between"), list):
        ends = channel["between"]
        channel["between"] = [e if e in GROUND_NAMES else _dof(f"{setting}.between", e, labels) for e in ends]
    if isinstance(channel.get("weights"), dict):
        weights = channel["weights"].items()
        channel["weights"] = {_dof(f"{setting}.weights", dof, labels): weight for dof, weight in weights}
    return channel


def _dof(setting: str, dof: object, labels: Labels) -> int:
    allowed = f"one of the DOFs {', '.join(labels.dofs)}, or its number from 1 to {len(labels.dofs)}"
    return _number(setting, dof, labels.dofs, allowed)


def _number(setting: str, given: Any, names: Sequence[str], allowed: str) -> int:
    """Number, from 1, of what is given by its name or by its number."""
    if given in names:
        return names.index(given) + 1
    number = int(given) if isinstance(given, str) and given.isdecimal() else given
    if is_whole_number(number) and 1 <= number <= len(names):
        return int(number)
    raise InputError(setting, given, allowed, suggestion(str(given), names))


def named(record: Record, labels: Labels) -> Record:
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


@contextmanager
def in_names(labels: Labels) -> Iterator[None]:
    """Errors about `data.acceleration.3` name the DOF as the user does, within the block."""
    try:
        yield
    except InputError as error:
        match = re.fullmatch(rf"(data\.(?:validation\.)?(?:{'|'.join(OF_DATA)}))\.(\d+)", error.setting)
        if match is None or not labels.dofs or not 1 <= int(match[2]) <= len(labels.dofs):
            raise
        setting = f"{match[1]}.{labels.dofs[int(match[2]) - 1]}"
        raise InputError(setting, error.value, error.allowed, error.hint) from None
