"""The files of a record, on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pinn_cli.record.clock import Clock
from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.formats import format_of
from pinn_cli.record.files.joined import joined
from pinn_cli.record.files.table import Table, check_names
from pinn_cli.settings.errors import InputError

# What a column of times is called unless the user says otherwise.
TIME_COLUMN = "t"


@dataclass(frozen=True)
class MeasuredFiles:
    """Files of one record, and how their samples' times are told.

    Attributes:
        paths: Of one file or more; those of several stand on one clock.
        format: How numbers lie in them; a file whose suffix is that of another format is read as that.
        time: Column of the times, in every file; None: `TIME_COLUMN`, unless ``sampling_rate`` is given or the format
            tells times of its own.
        sampling_rate: Hz, in place of a column of times; the first sample is then at 0 s.
        time_unit: Of that column: s, ms or us.
    """

    paths: tuple[Path, ...]
    format: FileFormat
    time: str | None = None
    sampling_rate: float | None = None
    time_unit: str = "s"

    def read(self, wanted: Mapping[str, str] | None = None) -> Clock:
        """The columns that are asked for, and when they were sampled.

        Args:
            wanted: Setting to the name of the column that it asks for, that of the times left out; None: every column
                that has numbers.

        Raises:
            InputError: A file, column or cell that cannot be used; nothing tells the times; clocks of several files
                that do not overlap, or columns of the same name in two of them.
        """
        if len(self.paths) == 1:
            return self._clock(self._table(self.paths[0], wanted))
        clocks = [self._clock(self._table(path, None)) for path in self.paths]
        times = {clock.column for clock in clocks}
        if wanted is not None:
            names = [name for clock in clocks for name in clock.table.columns if name not in times]
            for setting, column in wanted.items():
                if column not in names:
                    shown = Path(", ".join(path.name for path in self.paths))
                    check_names(shown, {setting: column}, names)
            kept = set(wanted.values())
            clocks = [replace(clock, table=_only(clock.table, kept)) for clock in clocks]
        table = joined([clock.table for clock in clocks], [clock.time for clock in clocks], sorted(times))
        assert table.time is not None
        return Clock(table, "", table.time, several=True)

    def time_column(self, path: Path) -> str | None:
        """Column of a file's times; None: the sampling rate is given, or looked for in the file's header."""
        if self.time is not None:
            return self.time
        return None if self.sampling_rate is not None or format_of(path, self.format).tells_time else TIME_COLUMN

    def _table(self, path: Path, wanted: Mapping[str, str] | None) -> Table:
        time = self.time_column(path)
        if wanted is not None and time is not None:
            wanted = {"data.time": time, **wanted}
        table = format_of(path, self.format).read(path, wanted)
        if time is not None:
            check_names(path, {"data.time": time}, table.columns, "or give data.sampling_rate, in Hz")
        return table

    def _clock(self, table: Table) -> Clock:
        if self.sampling_rate is not None:
            return Clock.by_rate(table, self.sampling_rate)
        column = self.time_column(table.path)
        if column is not None:
            return Clock.by_column(table, column, self.time_unit)
        if table.time is None:
            hint = f"{table.path.name} does not say when its samples were taken"
            raise InputError("data.sampling_rate", None, "given, in Hz, or data.time, a column of times", hint)
        return Clock(table, "", table.time)


def _only(table: Table, names: set[str]) -> Table:
    return replace(table, columns={name: values for name, values in table.columns.items() if name in names})
