"""`pinn-run inspect data=...`: from the configuration to the columns that are looked at, and the structure beside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.config import RunConfig, resolved
from pinn_cli.cli.dof_names import numbered
from pinn_cli.cli.source import read_structure
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, check_classes
from pinn_cli.settings.legal_values import entries, finite_number
from pinn_cli.settings.paths import located

if TYPE_CHECKING:
    import numpy as np

    from pinn_cli.record.data_channels import DataChannel
    from pinn_cli.record.signal import Signal
    from pinn_cli.system.structure import Structure


@dataclass(frozen=True, eq=False)
class Inspected:
    """What a look at a record is given.

    Attributes:
        signals: Its columns.
        time: (N,), s.
        frequencies: Natural frequencies of the structure, Hz; None where its parameters were not given.
        measured: Whether the columns are those of files.
    """

    signals: Sequence[Signal]
    time: np.ndarray
    frequencies: np.ndarray | None
    measured: bool

    @classmethod
    def read(cls, config: DictConfig, base: Path) -> Inspected:
        """Of a composed configuration, without its `hydra` node.

        Raises:
            InputError: The record cannot be read.
        """
        config = resolved(config)
        check_classes(config)
        structure = _structure(config, base)
        if structure is not None:
            config = numbered(config, structure.labels)
        frequencies = None if structure is None else _frequencies(structure)
        data = config.data
        if data.get("records"):
            hint = "one after the other: data.path=... and its columns"
            raise InputError("data.records", data.records, "left out with inspect, which looks at one record", hint)
        if "path" in data and "format" in data:
            return cls(*_of_files(data, base), frequencies, measured=True)
        return cls(*_of_record(config, base), frequencies, measured=False)


def _of_files(data: DictConfig, base: Path) -> tuple[list[Signal], np.ndarray]:
    """The columns that the settings name, else all that there are; within the window."""
    import numpy as np

    from pinn_cli.record.clock import MeasuredFiles
    from pinn_cli.record.files.table import SensorHint

    paths = [data.path] if isinstance(data.path, str) else entries(data.path)
    if not paths or not all(isinstance(path, str) and path for path in paths):
        raise InputError("data.path", data.path, f"given: data={data.get('kind')} reads a file of yours, or several")
    files = MeasuredFiles(
        tuple(located(path, base) for path in paths), build(data.format, "data.format"), data.get("time"),
        data.get("sampling_rate"), data.get("time_unit"),
    )  # fmt: skip
    said = {channel.column: channel for channel in _channels(data)}
    clock = files.read({channel.setting: channel.column for channel in said.values()} or None)
    table, time = clock.table, clock.time
    first, last = (None if data.get(name) is None else finite_number(f"data.{name}", data[name]) for name in _WINDOW)
    within = slice(
        0 if first is None else int(np.searchsorted(time, first, side="left")),
        len(time) if last is None else int(np.searchsorted(time, last, side="right")),
    )
    signals = []
    for column in table.columns:
        if column != clock.column:
            unit = table.hints.get(column, SensorHint()).unit
            values = table.numbers(column, within.start, within.stop)
            signals.append(_signal(column, values, unit, said.get(column)))
    if not signals:
        raise InputError("data.path", data.path, "a file with columns of numbers beside the times")
    return signals, time[within]


_WINDOW = ("start", "stop")


def _channels(data: DictConfig) -> list[DataChannel]:
    """The columns that the settings name, in the short form and in the long one."""
    from pinn_cli.record.data_channels import DataChannel, data_channels
    from pinn_cli.record.response import GROUND, QUANTITIES

    found = []
    for quantity in QUANTITIES:
        columns: Any = data.get(quantity) or {}
        if not isinstance(columns, Mapping | DictConfig):
            raise InputError(f"data.{quantity}", columns, "a map of DOF: column")
        for dof, column in columns.items():
            if not str(dof).isdecimal() or int(dof) < 1:
                raise InputError(f"data.{quantity}", dof, "a map whose keys are different DOFs, counted from 1")
            if column is not None:
                setting = f"data.{quantity}.{dof}"
                found.append(DataChannel(setting, str(column), str(column), quantity, {int(dof) - 1: 1.0}))
    if data.get(GROUND) is not None:
        found.append(DataChannel(f"data.{GROUND}", str(data[GROUND]), str(data[GROUND]), GROUND))
    channels = data.get("channels")
    plain: Any = OmegaConf.to_container(channels) if OmegaConf.is_config(channels) else channels
    return [*found, *data_channels(plain)]


def _signal(column: str, values: np.ndarray, unit: str, channel: DataChannel | None) -> Signal:
    """A column; what is measured at several DOFs, or in a connection, goes by its column's name."""
    from pinn_cli.record.signal import Signal
    from pinn_cli.system.quantities import UNITS

    if channel is None or channel.place is None:
        return Signal(column, values, unit=unit)
    quantity, dof = channel.place
    if channel.factor is not None:
        values, unit = channel.factor * values, UNITS[quantity]
    return Signal(column, values, quantity, str(dof) if dof else "", unit)


def _of_record(config: DictConfig, base: Path) -> tuple[list[Signal], np.ndarray]:
    """The sensors of a record that is simulated, or that somebody's own class reads."""
    from pinn_cli.record.channels import channels
    from pinn_cli.record.response import MEASURED_QUANTITIES
    from pinn_cli.record.signal import Signal

    run = RunConfig.read(config, base)
    true, _ = run.model_error.structures(run.structure)
    record = run.observe(run.source.measure(true).record)
    every = channels(record, MEASURED_QUANTITIES)
    return [
        Signal(channel.name, channel.measured, channel.quantity, "" if channel.dof < 0 else channel.where)
        for channel in every
    ], record.time


def _structure(config: DictConfig, base: Path) -> Structure | None:
    """The structure, whose values may be missing; None where nobody has described one."""
    try:
        return read_structure(config, base)
    except InputError:
        described = ("m", "k", "mass", "connections", "dofs", "M", "K")
        if any(config.system.get(name) is not None for name in described):
            raise
        return None


def _frequencies(structure: Structure) -> np.ndarray | None:
    """Of the linear part of the structure, Hz; None where its parameters were not given."""
    import numpy as np

    from pinn_cli.system.modes import modes_of

    try:
        found = modes_of(structure).natural_frequencies
    except np.linalg.LinAlgError:  # NaN among the parameters
        return None
    return found if np.isfinite(found).any() else None
