"""TDMS files of LabVIEW, by npTDMS: channels by group and name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pinn_cli.record.files.file_format import ArrayFormat
from pinn_cli.record.files.table import SensorHint
from pinn_cli.record.files.variables import Variable, content_of


class TdmsFormat(ArrayFormat):
    """Channels ``group/channel``, or ``channel`` where one group alone has it.

    The times are those of the channels' own ``wf_start_offset`` and ``wf_increment``. Channels of different rates stand
    on one clock.
    """

    name = "tdms"
    suffixes = (".tdms",)
    tells_time = True
    expected = "a TDMS file"
    beginnings = (b"TDSm",)
    package = "nptdms"

    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """See :class:`ArrayFormat`."""
        import nptdms

        file = nptdms.TdmsFile.open(path)
        if file.file_status.incomplete_final_segment:
            raise ValueError("its last segment is incomplete")
        channels = [channel for group in file.groups() for channel in group.channels()]
        if not channels:
            raise ValueError("it has no channels")
        variables = {f"{channel.group_name}/{channel.name}": _variable(channel) for channel in channels}
        counts = Counter(channel.name for channel in channels)
        unique = {c.name: variables[f"{c.group_name}/{c.name}"] for c in channels if counts[c.name] == 1}
        return {**variables, **{name: variable for name, variable in unique.items() if name not in variables}}


def _variable(channel: Any) -> Variable:
    properties = channel.properties
    step, start = properties.get("wf_increment"), properties.get("wf_start_offset", 0.0)
    time = _time(float(start), float(step), len(channel)) if isinstance(step, int | float) and step > 0 else None
    unit = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
    content = "nothing" if channel.dtype is None else content_of(np.dtype(channel.dtype))
    return Variable((len(channel), 1), lambda: channel[:], content, SensorHint(unit), time)


@cache  # one array for all channels of a clock
def _time(start: float, step: float, count: int) -> np.ndarray:
    return start + step * np.arange(count)
