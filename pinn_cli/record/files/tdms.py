"""TDMS files of LabVIEW, by npTDMS: channels by group and name."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.arrays import as_float, content_of
from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.joined import joined
from pinn_cli.record.files.on_disk import beginning, check_size, damaged, other_format
from pinn_cli.record.files.table import SensorHint, Table, check_names, same_length
from pinn_cli.settings.errors import InputError

_EXPECTED = "a TDMS file"


class TdmsFormat(FileFormat):
    """Channels ``group/channel``, or ``channel`` where one group alone has it.

    The times are those of the channels' own ``wf_start_offset`` and ``wf_increment``. Channels of different rates stand
    on one clock.
    """

    name = "tdms"
    suffixes = (".tdms",)
    tells_time = True

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        content = beginning(path)
        if not content.startswith(b"TDSm"):
            raise other_format(path, content, _EXPECTED)
        nptdms = self.package("nptdms")
        self.package("nptdms.log").log_manager.set_level(logging.CRITICAL)  # what is wrong is told by an error
        try:
            with nptdms.TdmsFile.open(path) as file:
                if file.file_status.incomplete_final_segment:
                    raise damaged(path, _EXPECTED, ValueError("its last segment is incomplete"))
                channels = _channels(file)
                if not channels:
                    raise damaged(path, _EXPECTED, ValueError("it has no channels"))
                return _read(path, channels, wanted)
        except InputError:
            raise
        except Exception as error:  # npTDMS raises a dozen kinds of a file that is damaged
            raise damaged(path, _EXPECTED, error) from None


def _channels(file: Any) -> dict[str, Any]:
    """Channels by their full names, and by their own where one alone has it."""
    every = {f"{group.name}/{channel.name}": channel for group in file.groups() for channel in group.channels()}
    counts = Counter(channel.name for channel in every.values())
    return {**every, **{c.name: c for c in every.values() if counts[c.name] == 1 and c.name not in every}}


def _read(path: Path, channels: Mapping[str, Any], wanted: Mapping[str, str] | None) -> Table:
    if wanted is None:
        names = [n for n in channels if "/" in n and _holds(channels[n]) == "" and len(channels[n])]
    else:
        check_names(path, wanted, channels)
        names = list(dict.fromkeys(wanted.values()))
        for setting, name in wanted.items():
            if _holds(channels[name]):
                hint = f"in {path.name} it holds {_holds(channels[name])}"
                raise InputError(setting, repr(name), "a channel of numbers", hint)
    check_size(path, sum(8 * len(channels[name]) for name in names))
    clocks: dict[tuple[int, float, float] | None, list[str]] = {}
    for name in names:
        clocks.setdefault(_clock(channels[name]), []).append(name)
    tables = [_table(path, {name: channels[name] for name in group}, clock) for clock, group in clocks.items()]
    if len(tables) > 1 and all(table.time is not None for table in tables):
        return joined(tables, [table.time for table in tables if table.time is not None])
    columns = {name: values for table in tables for name, values in table.columns.items()}
    same_length(path, columns)
    hints = {name: hint for table in tables for name, hint in table.hints.items()}
    time = tables[0].time if len(tables) == 1 else None
    return Table(path, columns, hints=hints, time=time)


def _clock(channel: Any) -> tuple[int, float, float] | None:
    """Samples, time of the first one and step, s; None of a channel that does not tell them."""
    step = channel.properties.get("wf_increment")
    if not isinstance(step, int | float) or not step > 0:
        return None
    return len(channel), float(channel.properties.get("wf_start_offset", 0.0)), float(step)


def _table(path: Path, channels: Mapping[str, Any], clock: tuple[int, float, float] | None) -> Table:
    columns = {name: as_float(channel[:]) for name, channel in channels.items()}
    units = {
        name: str(channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or "")
        for name, channel in channels.items()
    }
    time = None if clock is None else clock[1] + clock[2] * np.arange(clock[0])
    return Table(path, columns, hints={name: SensorHint(unit) for name, unit in units.items() if unit}, time=time)


def _holds(channel: Any) -> str:
    """What a channel holds instead of numbers; "" of numbers."""
    return content_of(np.dtype(channel.dtype)) if channel.dtype is not None else "nothing"
