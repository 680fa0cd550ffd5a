"""What every format of a file is: text, or arrays that a library reads in a process of its own."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from dataclasses import astuple
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from pinn_cli.record.files.on_disk import check_size, damaged, other_format, read_bytes
from pinn_cli.record.files.table import TIME_COLUMN, SensorHint, Table
from pinn_cli.record.files.variables import Variable, joined, tables_of
from pinn_cli.runs.apart import Answer, UnreadableError, read_apart
from pinn_cli.runs.machine import of_this_machine
from pinn_cli.settings.errors import InputError

# Of a file, bytes that tell what it is.
_START = 4096
# Of the memory, the part that a file may take: its content, its numbers as stored, as float64 and on their way, a
# sixteenth each at most.
_PART_OF_MEMORY = 4


class FileFormat(ABC):
    """How numbers lie in a file.

    A format reads numbers and runs nothing: it unpickles no object and evaluates no formula.

    Attributes:
        name: As in ``data=NAME``, and the extra that brings the package it needs, if it needs one.
        suffixes: That tell this format, in small letters, with the point.
        other_suffixes: That such files may have too, although they tell another one.
        tells_time: Whether the files' header may say when the samples were taken.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    other_suffixes: ClassVar[tuple[str, ...]] = ()
    tells_time: ClassVar[bool] = False

    @abstractmethod
    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """The columns of a file.

        Args:
            path: Of the file.
            wanted: Setting to the name of the column that it asks for, "" for that of the times by whatever name; None:
                every column that has numbers.

        Raises:
            InputError: The file is missing, cannot be read or is in another format, or lacks a column.
        """


class ArrayFormat(FileFormat):
    """Arrays by name. A library reads them in a process of its own, which a bad file may end, fill or keep busy.

    Attributes:
        expected: What such a file is called in errors, with its article.
        beginnings: With which such files begin.
        package: That reads them and need not be installed; "": one that is always there.
    """

    expected: ClassVar[str]
    beginnings: ClassVar[tuple[bytes, ...]]
    package: ClassVar[str] = ""

    @abstractmethod
    def variables(self, path: Path, wanted: Collection[str] | None) -> Mapping[str, Variable]:
        """The arrays of a file by name, in the process that reads it; one that has a second name has it further down.

        Beside columns that are wanted, if names of some are given, none need be looked at. Whatever is raised here but
        an InputError says that the file is damaged.
        """

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        content = read_bytes(path, most=_START)
        if not self.begins(content):
            raise other_format(path, content, self.expected)
        if self.package and find_spec(self.package) is None:
            allowed = f"a format whose package is installed; {self.name} needs {self.package}"
            raise InputError("data.format", self.name, allowed, f"pip install 'pinn-cli[{self.name}]'")
        tables = self._tables_apart(path, wanted)
        return tables[0] if len(tables) == 1 else joined(tables, [t.time for t in tables if t.time is not None])

    def _tables_apart(self, path: Path, wanted: Mapping[str, str] | None) -> list[Table]:
        """What :meth:`tables` reads in the other process, which may take no more memory or time than a file may."""
        kind, memory = type(self), of_this_machine() // _PART_OF_MEMORY
        asked = None if wanted is None else dict(wanted)
        question = [kind.__module__, kind.__qualname__, vars(self), str(path), asked]
        try:
            [(layout, values)] = read_apart(answered, question, [path], memory)
        except UnreadableError as error:
            raise damaged(path, self.expected, str(error)) from None
        arrays, tables = iter(values), []
        for names, hints, timed, odd, first_line, notes in layout:
            columns = {name: next(arrays) for name in names}
            sensor_hints = {name: SensorHint(*texts) for name, texts in hints.items()}
            cells = {name: {int(row): text for row, text in of_column.items()} for name, of_column in odd.items()}
            tables.append(Table(path, columns, cells, sensor_hints, next(arrays) if timed else None, first_line, notes))
        return tables

    def tables(self, path: Path, wanted: Mapping[str, str] | None) -> list[Table]:
        """The columns in one table for each clock, read in this process.

        Raises:
            InputError: The file is damaged, lacks a column or does not fit into memory; or a package does not work.
        """
        try:
            tables = self.read_tables(path, wanted)
            size: float = sum(values.nbytes for table in tables for values in table.columns.values())
        except InputError:
            raise
        except ImportError as error:
            raise InputError("data.format", self.name, "a format whose package works", str(error)) from None
        except MemoryError:
            tables, size = [], math.inf
        except Exception as error:  # libraries raise dozens of kinds
            reason = str(error).strip().partition("\n")[0] or type(error).__name__
            raise damaged(path, self.expected, reason) from None
        check_size(path, size)
        return tables

    def read_tables(self, path: Path, wanted: Mapping[str, str] | None) -> list[Table]:
        """See :meth:`tables`; raises what :meth:`variables` does."""
        names = None if wanted is None else [column or TIME_COLUMN for column in wanted.values()]
        return tables_of(path, self.variables(path, names), wanted)

    def begins(self, content: bytes) -> bool:
        """Whether a file of this format may begin so."""
        return content.startswith(self.beginnings)


def answered(
    module: str, name: str, settings: Mapping[str, Any], path: str, wanted: Mapping[str, str] | None
) -> Iterator[Answer]:
    """What the other process answers: the layout of the tables of a file, and their arrays."""
    file_format = object.__new__(getattr(import_module(module), name))
    vars(file_format).update(settings)
    tables = file_format.tables(Path(path), wanted)
    hints = ({name: astuple(hint) for name, hint in t.hints.items()} for t in tables)
    layout = [
        (list(t.columns), of_table, t.time is not None, t.odd_cells, t.first_line, list(t.notes))
        for t, of_table in zip(tables, hints, strict=True)
    ]
    yield layout, [values for t in tables for values in (*t.columns.values(), *(() if t.time is None else (t.time,)))]
