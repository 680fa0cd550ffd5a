"""`pinn-run inspect FILE`, `modes FILE`, `population RUN ...`: from the configuration to what records or runs show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.config import resolved
from pinn_cli.cli.records import data_of_records, numbered, of_record
from pinn_cli.cli.source import read_structure
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, check_classes
from pinn_cli.settings.legal_values import entries, finite_number, located, whole_number

if TYPE_CHECKING:
    import numpy as np

    from pinn_cli.inspection.mode_report import ModesReport
    from pinn_cli.inspection.proposal import Said
    from pinn_cli.inspection.report import InspectionReport, LookReport
    from pinn_cli.record.clock import MeasuredFiles
    from pinn_cli.record.data_channels import DataChannel
    from pinn_cli.record.files.file_format import FileFormat
    from pinn_cli.record.signal import Signal
    from pinn_cli.sweep.population import PopulationReport
    from pinn_cli.system.modes import NaturalModes
    from pinn_cli.system.structure import Structure

# Settings of which one at least describes a structure.
DESCRIBING = ("m", "k", "mass", "connections", "dofs", "M", "K")


@dataclass(frozen=True, eq=False)
class Inspected:
    """What a look at a record is given.

    Attributes:
        signals: Its columns.
        time: (N,), s.
        structure: Whose parameters were all given; None.
        frequencies: Natural frequencies of its linear part, Hz; None.
        modes: Of the same; None.
        said: By the command, and by the file.
    """

    signals: Sequence[Signal]
    time: np.ndarray
    structure: Structure | None
    frequencies: np.ndarray | None
    modes: NaturalModes | None
    said: Said

    @classmethod
    def read(cls, config: DictConfig, base: Path, command: str, said: Said | None = None) -> list[Inspected]:
        """Of all records that a composed configuration, without its `hydra` node, has.

        Relative paths start from ``base``. The command is the word that asks for it; `inspect` looks at one record.

        Raises:
            InputError: A record cannot be read, or there are several for `inspect`.
        """
        import numpy as np

        from pinn_cli.inspection.proposal import Said
        from pinn_cli.system.modes import NaturalModes, modes_of

        if command == "inspect" and config.data.get("records"):
            hint = "one after the other: data.path=... and its columns"
            given: Any = OmegaConf.to_container(config.data.records)
            raise InputError("data.records", given, "left out with inspect, which looks at one record", hint)
        config = resolved(config)
        check_classes(config)
        structure, frequencies, modes = None, None, None
        try:
            described = read_structure(config, base)
            config = numbered(config, described.labels)
            natural = modes_of(described).natural_frequencies
            if np.isfinite(natural).any():
                structure, frequencies, modes = described, natural, NaturalModes.of(described)
        except np.linalg.LinAlgError:  # NaN among the parameters
            pass
        except InputError:
            if any(config.system.get(name) is not None for name in DESCRIBING):
                raise
        if "path" not in config.data or "format" not in config.data:
            hint = f"pinn-run {command} FILE"
            raise InputError("data", config.data.get("kind"), f"csv or another format of files with {command}", hint)
        files, inspected = build(config.data.format, "data.format"), []
        system: Any = OmegaConf.to_container(config.system)
        records = data_of_records(config.data)
        if command == "modes" and len(records) == 1:
            records = _by_file(records[0], files, base)
        for number, data in enumerate(records, start=1):
            with of_record(number, len(records)):
                plain: Any = OmegaConf.to_container(data)
                signals, time, of_times = _columns(plain | {"format": files}, base)
                with_settings = replace(said or Said(), settings={"data": plain, "system": system}, time=of_times)
                inspected.append(cls(signals, time, structure, frequencies, modes, with_settings))
        return inspected


def inspected_record(config: DictConfig, base: Path, said: Said) -> InspectionReport:
    """Look at the record of a composed configuration; one of too few samples, or where no column varies, is refused."""
    from pinn_cli.inspection.inspection import contradictions, inspect_record

    (record,) = Inspected.read(config, base, "inspect", said)
    report = inspect_record(record.signals, record.time, record.said, record.frequencies)
    if record.structure is None:
        return report
    return replace(report, notes=(*report.notes, *contradictions(record.structure, report.signals, report.sampling)))


def modes_of_records(config: DictConfig, base: Path, said: Said) -> ModesReport:
    """Modes that records show; one of too few samples, or without a sensor that varies, is refused."""
    from pinn_cli.inspection.mode_report import ModesReport
    from pinn_cli.inspection.modes import ModalRecord

    looked_at, records = Inspected.read(config, base, "modes", said), []
    for number, record in enumerate(looked_at, start=1):
        with of_record(number, len(looked_at)):
            records.append(ModalRecord.of(record.signals, record.time))
    return ModesReport(records, looked_at[0].modes)


def population_of_runs(config: DictConfig, base: Path, said: Said) -> PopulationReport:
    """Of the finished runs that a configuration names as models; too few, or such as differ in all, are refused."""
    from pinn_cli.sweep.population import PopulationReport

    return PopulationReport.of(list(config.model or ()), base)


# What a word on the command line has looked at: of a composed configuration, from a folder on.
LOOKED_AT: Mapping[str, Callable[[DictConfig, Path, Said], LookReport]] = {
    "inspect": inspected_record,
    "modes": modes_of_records,
    "population": population_of_runs,
}


def _by_file(data: DictConfig, files: FileFormat, base: Path) -> list[DictConfig]:
    """The settings of every file as a record of its own, where two of them have a column in common; else as they are.

    No sensor is in two files of one clock. Of the columns that settings name a record has those of its file.
    """
    plain: Any = OmegaConf.to_container(data)
    if not isinstance(plain["path"], list) or len(plain["path"]) == 1:
        return [data]
    measured = _files(plain | {"format": files}, base)
    columns = [
        {column for column in measured.table(path, None).columns if not measured.takes_for_times(column)}
        for path in measured.paths
    ]
    all_names = set[str]().union(*columns)
    if len(all_names) == sum(map(len, columns)):
        return [data]
    return [
        OmegaConf.create(plain | _of_file(plain, all_names - names) | {"path": path})
        for path, names in zip(plain["path"], columns, strict=True)
    ]


def _of_file(data: Mapping[str, Any], elsewhere: set[str]) -> dict[str, Any]:
    """Settings of columns, without those that are in another file."""
    from pinn_cli.record.response import QUANTITIES
    from pinn_cli.system.quantities import GROUND

    settings: dict[str, Any] = {}
    for name in (*QUANTITIES, "channels"):
        if isinstance(data.get(name), Mapping):
            settings[name] = {}
            for key, given in data[name].items():
                column = (given.get("column") or key) if isinstance(given, Mapping) else given
                if str(column) not in elsewhere:
                    settings[name][key] = given
    if data.get(GROUND) in elsewhere:
        settings[GROUND] = None
    return settings


def _files(data: Mapping[str, Any], base: Path) -> MeasuredFiles:
    from pinn_cli.record.clock import MeasuredFiles

    paths = [data["path"]] if isinstance(data["path"], str) else entries(data["path"])
    if not paths or not all(isinstance(path, str) and path for path in paths):
        hint = f"given: data={data.get('kind')} reads a file of yours, or several"
        raise InputError("data.path", data["path"], hint)
    return MeasuredFiles(
        tuple(located(path, base) for path in paths), data["format"], data.get("time"), data.get("sampling_rate"),
        data.get("time_unit"), data.get("missing"),
    )  # fmt: skip


def _columns(data: Mapping[str, Any], base: Path) -> tuple[list[Signal], np.ndarray, str]:
    """The columns that the settings name, else all that have numbers; of the window, as it is to be thinned.

    And their times, and the column that has these where nobody has said so.
    """
    import numpy as np

    from pinn_cli.record.files.table import SensorHint, is_called_times
    from pinn_cli.record.sampled import reached, with_fewer
    from pinn_cli.record.spectrum import BandPass, checked_band

    files = _files(data, base)
    said = {channel.column: channel for channel in _channels(data)}
    wanted = {channel.setting: channel.column for channel in said.values()} or None
    unsaid = None
    if wanted is None and len(files.paths) == 1:
        read = files.table(files.paths[0], None)
        unsaid = files.unsaid_times(read)
        clock = replace(files, time=unsaid or files.time).clock(read)
    else:
        clock = files.read(wanted)
    table = clock.table
    first, last = 0, len(clock.time)
    if data.get("start") is not None:
        first = int(np.searchsorted(clock.time, finite_number("data.start", data["start"]), side="left"))
    if data.get("stop") is not None:
        last = int(np.searchsorted(clock.time, finite_number("data.stop", data["stop"]), side="right"))
    window = first, last
    thinned: int | BandPass = whole_number("data.decimate", data.get("decimate") or 1, least=1)
    if band := checked_band(data.get("band")):
        thinned = BandPass.of(band, len(clock.time), clock.step(*window))
        window = reached(thinned, window, len(clock.time))
    columns = {}
    for column in table.columns:
        idle = not said and (is_called_times(column) or not np.isfinite(table.columns[column]).any())
        if column != clock.column and not idle:
            columns[column] = table.numbers(column, *window)
    if not columns:
        for column in (name for name in table.columns if name != clock.column):
            table.numbers(column)  # which says what its cells are, where they are no numbers
        raise InputError("data.path", data["path"], "a file with columns of numbers beside the times")
    time = clock.time[slice(*window)]
    if thinned != 1:
        time, even = clock.regular(*window)
        whole = even and all(np.isfinite(values).all() for values in columns.values())
        time, thin = with_fewer(thinned, time, list(columns.values()), whole)
        columns = dict(zip(columns, thin, strict=True))
    units = {column: table.hints.get(column, SensorHint()).unit for column in columns}
    signals = [_signal(column, values, units[column], said.get(column)) for column, values in columns.items()]
    return signals, time, unsaid or ""


def _channels(data: Mapping[str, Any]) -> list[DataChannel]:
    """The columns that the settings name, in the short form and in the long one."""
    from pinn_cli.record.data_channels import DataChannel, data_channels
    from pinn_cli.record.measured_data import UNMEASURED
    from pinn_cli.record.response import QUANTITIES
    from pinn_cli.system.quantities import GROUND

    channels = []
    for quantity in QUANTITIES:
        columns = data.get(quantity) or {}
        if not isinstance(columns, Mapping):
            raise InputError(f"data.{quantity}", columns, "a map of DOF: column")
        for dof, column in columns.items():
            if not str(dof).isdecimal() or int(dof) < 1:
                raise InputError(f"data.{quantity}", dof, "a map whose keys are different DOFs, counted from 1")
            if column is not None:
                setting = f"data.{quantity}.{dof}"
                channels.append(DataChannel.of_column(setting, str(column), quantity, int(dof)))
    if data.get(GROUND) not in (None, UNMEASURED):
        channels.append(DataChannel.of_column(f"data.{GROUND}", str(data[GROUND]), GROUND))
    return [*channels, *data_channels(data.get("channels"))]


def _signal(column: str, values: np.ndarray, unit: str, channel: DataChannel | None) -> Signal:
    """A column; what is measured at several DOFs, or in a connection, goes by its column's name."""
    from pinn_cli.record.signal import Signal
    from pinn_cli.system.quantities import UNITS

    if channel is None or not channel.sensor.is_column:
        return Signal(column, values, unit=unit)
    quantity, dof = channel.sensor.quantity, channel.sensor.dof + 1
    if channel.factor is not None:
        values, unit = channel.factor * values, UNITS[quantity]
    return Signal(column, values, quantity, str(dof) if dof else "", unit)
