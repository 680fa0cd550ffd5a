"""`pinn-run inspect data=...`: from the configuration to the columns that are looked at, and the structure beside."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from pinn_cli.cli.config import RunConfig, read_structure, resolved
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, check_classes
from pinn_cli.settings.legal_values import entries, finite_number
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.settings.paths import located

if TYPE_CHECKING:
    import numpy as np

    from pinn_cli.inspection.signal import Signal

COMMAND = "inspect"
# What goes on with a run, or makes several, has nothing to do with a look at a record.
_LEFT_OUT = ("resume", "collect")


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
        frequencies = _frequencies(config, base)
        data = config.data
        if "path" in data and "format" in data:
            return cls(*_of_files(data, base), frequencies, measured=True)
        return cls(*_of_record(config, base), frequencies, measured=False)


def taken_out(arguments: list[str], options: Namespace) -> bool:
    """Whether the command line says `inspect`; the word is taken out of it, and what goes ill with it is refused.

    Args:
        arguments: `sys.argv`, changed in place.
        options: As read, changed in place.

    Raises:
        InputError: Something else is asked for along with it.
    """
    if COMMAND not in options.overrides:
        return False
    if options.multirun:
        raise InputError("--multirun", COMMAND, f"left out with {COMMAND}", "one record is looked at at a time")
    for override in options.overrides:
        name = setting_of(override)
        if name in _LEFT_OUT:
            raise InputError(name, override.partition("=")[2], f"left out with {COMMAND}")
    options.overrides.remove(COMMAND)
    arguments.remove(COMMAND)
    return True


def _of_files(data: DictConfig, base: Path) -> tuple[list[Signal], np.ndarray]:
    """The columns that the settings name, else all that there are; within the window."""
    import numpy as np

    from pinn_cli.inspection.signal import Signal
    from pinn_cli.record.files.table import SensorHint
    from pinn_cli.record.measured_files import MeasuredFiles

    paths = [data.path] if isinstance(data.path, str) else entries(data.path)
    if not paths or not all(isinstance(path, str) and path for path in paths):
        raise InputError("data.path", data.path, f"given: data={data.get('kind')} reads a file of yours, or several")
    files = MeasuredFiles(
        tuple(located(path, base) for path in paths), build(data.format, "data.format"), data.get("time"),
        data.get("sampling_rate"), data.get("time_unit", "s"),
    )  # fmt: skip
    places = _named_columns(data)
    clock = files.read({setting: column for setting, (column, _, _) in places.items()} or None)
    table, time = clock.table, clock.time
    first, last = (None if data.get(name) is None else finite_number(f"data.{name}", data[name]) for name in _WINDOW)
    within = slice(
        0 if first is None else int(np.searchsorted(time, first, side="left")),
        len(time) if last is None else int(np.searchsorted(time, last, side="right")),
    )
    said = {column: (quantity, place) for column, quantity, place in places.values()}
    signals = []
    for column in table.columns:
        if column != clock.column:
            hint = table.hints.get(column, SensorHint())
            quantity, place = said.get(column, ("", ""))
            values = table.numbers(column, within.start, within.stop)
            signals.append(Signal(column, values, quantity, place, hint.unit))
    if not signals:
        raise InputError("data.path", data.path, "a file with columns of numbers beside the times")
    return signals, time[within]


_WINDOW = ("start", "stop")


def _named_columns(data: DictConfig) -> dict[str, tuple[str, str, str]]:
    """Setting to column, quantity and DOF, of the columns that the settings name."""
    from pinn_cli.record.record import GROUND, QUANTITIES

    found: dict[str, tuple[str, str, str]] = {}
    for quantity in QUANTITIES:
        columns: Any = data.get(quantity) or {}
        if not isinstance(columns, Mapping | DictConfig):
            raise InputError(f"data.{quantity}", columns, "a map of DOF: column")
        for dof, column in columns.items():
            if column is not None:
                found[f"data.{quantity}.{dof}"] = str(column), quantity, str(dof)
    if data.get(GROUND) is not None:
        found[f"data.{GROUND}"] = str(data[GROUND]), GROUND, ""
    return found


def _of_record(config: DictConfig, base: Path) -> tuple[list[Signal], np.ndarray]:
    """The sensors of a record that is simulated, or that somebody's own class reads."""
    from pinn_cli.inspection.signal import Signal
    from pinn_cli.record.channels import channels
    from pinn_cli.record.record import MEASURED_QUANTITIES

    run = RunConfig.read(config, base)
    true, _ = run.model_error.structures(run.structure)
    record = run.observe(run.source.measure(true).record)
    every = channels(record, MEASURED_QUANTITIES)
    return [
        Signal(channel.name, channel.measured, channel.quantity, "" if channel.dof < 0 else channel.where)
        for channel in every
    ], record.time


def _frequencies(config: DictConfig, base: Path) -> np.ndarray | None:
    """Of the linear part of the structure, Hz; None where its parameters are not given, or it is none."""
    import numpy as np

    from pinn_cli.verdict.modes import modes_of

    try:
        structure = read_structure(config, base)
        found = modes_of(structure).natural_frequencies
    except (InputError, np.linalg.LinAlgError):
        if any(config.system.get(name) is not None for name in ("m", "k", "mass", "connections", "M", "K")):
            raise
        return None
    return found if np.isfinite(found).any() else None
