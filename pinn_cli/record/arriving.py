"""A record that is still being measured: a file that grows, or a folder into which files arrive.

What has come is read once. Of text whole lines are taken: what stands behind the last line's end is still being
written. A file in another format is read again whenever it has changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pinn_cli.record.clock import LATEST_BEGIN, Clock, MeasuredFiles, format_of
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.file_format import FileFormat
from pinn_cli.record.files.table import Table
from pinn_cli.settings.errors import InputError

PATH_SETTING = "data.path"
# Bytes of text that are taken up before anybody may look at them.
MOST_AT_ONCE = 2**24
# Lines of text before which nobody can say how its cells are separated.
ENOUGH_LINES = 3


class Reader:
    """Rows of a file that may not be whole yet: it is read as a whole, as often as it changes.

    What is wanted are settings, to the name of the column that each asks for.
    """

    def __init__(self, path: Path, wanted: Mapping[str, str], file_format: FileFormat) -> None:
        self.path, self.wanted, self.format, self.rows = path, wanted, file_format, 0
        self._seen: tuple[int, int] | None = None
        self._error: InputError | None = None

    def more(self, complete: bool) -> Table | None:
        """The rows that have come since this was asked last; None where there are none.

        A file is complete when nobody writes to it any more.

        Raises:
            InputError: The file cannot be read, and has not changed for a while.
        """
        stat = self.path.stat()
        state = stat.st_size, stat.st_mtime_ns
        if state == self._seen and not (complete and self._error):
            if self._error is not None:
                raise self._error
            return None
        self._seen, self._error = state, None
        try:
            table = self.format.read(self.path, self.wanted)
        except InputError as error:
            if complete:
                raise
            self._error = error
            return None
        first, self.rows = self.rows, len(table)
        return _rows_from(table, first) if len(table) > first else None


class TextReader(Reader):
    """Rows of text, line by line."""

    format: CsvFormat

    def __init__(self, path: Path, wanted: Mapping[str, str], text: CsvFormat) -> None:
        super().__init__(path, wanted, text)
        self.head, self.place = b"", 0

    def more(self, complete: bool) -> Table | None:
        """See :meth:`Reader.more`."""
        content = self._whole_lines(complete)
        if content is None:
            return None
        text = (self.head + content).decode(self.format.encoding or "utf-8-sig", errors="replace")
        table = self.format.table(self.path, text, self.wanted)
        if not self.head:
            lines = content.splitlines(keepends=True)
            self.head = b"".join(lines[: (table.first_line or 1) - 1])
        numbered = replace(table, first_line=(table.first_line or 0) + self.rows)
        self.place, self.rows = self.place + len(content), self.rows + len(table)
        return numbered if len(table) else None

    def _whole_lines(self, complete: bool) -> bytes | None:
        """What lies between the last place and the end of a line; None where that is too little."""
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            if size < self.place:
                hint = "it is shorter than it was: let what measures it append to it, or begin another file"
                raise InputError(PATH_SETTING, self.path, "a file that grows", hint)
            file.seek(self.place)
            content = file.read(MOST_AT_ONCE)
        whole = complete and self.place + len(content) == size
        end = len(content) if whole else content.rfind(b"\n") + 1
        content = content[:end]
        few = not self.head and not complete and content.count(b"\n") < (self.format.names_line or 1) + ENOUGH_LINES
        return None if few or not content.strip() else content


class Arriving:
    """Samples in the order in which they were taken, of which those that nobody needs any more are forgotten.

    Files of a folder follow each other by their names. A file whose clock begins anew goes on one step after the last
    sample of the one before; one whose clock has gone on is taken at its word. A file is complete when the next one is
    there. What is wanted are settings, to the name of the column that each asks for, that of the times left out.
    """

    def __init__(self, files: MeasuredFiles, wanted: Mapping[str, str]) -> None:
        self.files, self.wanted = files, dict(wanted)
        (self.path,) = files.paths
        self.readers: list[Reader] = []
        self.table = Table(self.path, {name: np.zeros(0) for name in set(wanted.values())})
        self.time = np.zeros(0)
        self.samples = 0
        # The date at which the clock began, s. Seconds from a file's clock to the record's; on that its first time,
        # the last of all, and how many.
        self._begin, self._shift, self._first, self._last, self._count = 0.0, 0.0, np.nan, -np.inf, 0

    def read(self) -> bool:
        """Take up what has come; whether there was anything.

        Raises:
            InputError: A file cannot be used.
        """
        paths, before = self._paths(), self.samples
        for i, path in enumerate(paths):
            if i < len(self.readers) - 1:
                continue
            if i == len(self.readers):
                column = self.files.time_column(path)
                asked = self.wanted if column is None else {"data.time": column, **self.wanted}
                file_format = format_of(path, self.files.format)
                reader = Reader(path, asked, file_format)
                if isinstance(file_format, CsvFormat):
                    reader = TextReader(path, asked, file_format)
                self.readers.append(reader)
                if self._count:  # should the file's clock begin anew, it goes on one step after the last sample
                    self._shift = self._last + (self._last - self._first) / max(self._count - 1, 1)
                    self._first, self._count = np.nan, 0
            table = self.readers[i].more(complete=i + 1 < len(paths))
            if table is not None:
                self._append(table)
        return self.samples > before

    @property
    def clock(self) -> Clock:
        """The samples that are kept."""
        return Clock(self.table, "", self.time, several=True)

    def forget_before(self, time: float) -> None:
        """No sample before a time, s, is needed any more."""
        first = int(np.searchsorted(self.time, time))
        self.table, self.time = _rows_from(self.table, first), self.time[first:]

    def _paths(self) -> list[Path]:
        if not self.path.is_dir():
            return [self.path] if self.path.exists() else []
        suffixes = (*self.files.format.suffixes, *self.files.format.other_suffixes)
        files = (entry for entry in self.path.iterdir() if entry.is_file() and entry.suffix.lower() in suffixes)
        paths = sorted(file for file in files if not file.name.startswith("."))  # as while it is being copied
        earlier = [reader.path for reader in self.readers]
        if paths[: len(earlier)] != earlier:
            late = next((path for path in paths if path not in earlier), self.path)
            allowed = "files that arrive in the order of their names, and stay"
            raise InputError(PATH_SETTING, late.name, allowed, f"{earlier[-1].name} was there before")
        return paths

    def _append(self, table: Table) -> None:
        table = table.with_gaps(self.files.missing, self.files.column_in(table))
        times = self._file_times(table)
        if self.samples == 0 and times[0] > LATEST_BEGIN:
            self._begin = times[0]
        times = times - self._begin
        if self._count == 0:
            self._shift = 0.0 if times[0] > self._last else self._shift - times[0]
            self._first = times[0] + self._shift
        time = times + self._shift
        if len(self.time) and time[0] <= self.time[-1]:
            allowed = f"a time after the one before it, {self.time[-1]:.9g} s"
            raise InputError(f"{table.path.name}, first new line", f"{time[0]:.9g} s", allowed)
        self._last, self._count = float(time[-1]), self._count + len(time)
        kept, self.samples = len(self.time), self.samples + len(time)
        columns = {name: np.concatenate((values, table.columns[name])) for name, values in self.table.columns.items()}
        odd = {name: dict(cells) for name, cells in self.table.odd_cells.items()}
        for name, cells in table.odd_cells.items():
            odd.setdefault(name, {}).update({kept + row: text for row, text in cells.items()})
        self.table = Table(table.path, columns, odd, self.table.hints or table.hints)
        self.time = np.concatenate((self.time, time))

    def _file_times(self, table: Table) -> np.ndarray:
        """(N,), s, as the file has them."""
        if self.files.sampling_rate is not None:
            return (self.samples + np.arange(len(table))) / self.files.sampling_rate
        column = self.files.column_in(table)
        if column is not None:
            return Clock.by_column(table, column, self.files.time_unit).time
        if table.time is None:
            raise InputError("data.sampling_rate", None, "given, in Hz, or data.time, a column of times")
        return table.time


def _rows_from(table: Table, first: int) -> Table:
    """The rows of a table from one on."""
    odd = {
        name: {row - first: text for row, text in cells.items() if row >= first}
        for name, cells in table.odd_cells.items()
    }
    line = None if table.first_line is None else table.first_line + first
    time = None if table.time is None else table.time[first:]
    columns = {name: values[first:] for name, values in table.columns.items()}
    return replace(table, columns=columns, odd_cells=odd, time=time, first_line=line)
