"""A file before anyone looks for numbers, and what every format is: text, or arrays that a library reads apart."""

from __future__ import annotations

import codecs
import gzip
import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import astuple
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar

from pinn_cli.record.files.table import TIME_COLUMN, SensorHint, Table
from pinn_cli.record.files.variables import Variable, joined, tables_of
from pinn_cli.runs.apart import Answer, UnreadableError, read_apart
from pinn_cli.runs.process import of_this_machine
from pinn_cli.settings.errors import InputError

# Of a file, bytes that tell what it is.
FIRST_BYTES = 4096
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
        content = read_bytes(path, most=FIRST_BYTES)
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
    layout = []
    for t in tables:
        hints = {name: astuple(hint) for name, hint in t.hints.items()}
        layout.append((list(t.columns), hints, t.time is not None, t.odd_cells, t.first_line, list(t.notes)))
    yield layout, [values for t in tables for values in (*t.columns.values(), *(() if t.time is None else (t.time,)))]


# Of the memory, at most this part: text, cells and numbers of a file take some ten times its size.
PART_OF_MEMORY = 16
# How files begin whose names do not always say what they are.
_UNIVERSAL, _GZIP = b"    -1", b"\x1f\x8b"
PACKED_AS = {
    _GZIP: "gzip",
    b"PK\x03\x04": "a zip archive or a spreadsheet (data=excel)",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"\x28\xb5\x2f\xfd": "Zstandard",
    b"\xd0\xcf\x11\xe0": "a spreadsheet",
    b"\x89HDF": "HDF5 (data=hdf5, data=mat or data=netcdf)",
    b"MATLAB 5.0": "a MAT file (data=mat)",
    b"MATLAB 7.3": "a MAT file (data=mat)",
    b"PAR1": "Parquet (data=parquet)",
    b"TDSm": "TDMS (data=tdms)",
    b"CDF": "netCDF (data=netcdf)",
    _UNIVERSAL: "a universal file (data=uff)",
}
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
# Of text that is no UTF-8: what Windows writes in Western Europe and America. The numbers are the same in any of them.
_FALLBACK = "cp1252"
_SAVE_AS = "save it as text with separated values, in UTF-8"


def read_bytes(path: Path, setting: str = "data.path", most: int = -1) -> bytes:
    """All of a file that a setting has named, or its first ``most`` bytes; -1: all.

    Raises:
        InputError: It is missing, is no regular file, cannot be read, or is larger than memory can hold.
    """
    try:
        if not path.exists():
            raise InputError(setting, path, "a file that exists", "a relative path starts where pinn-run was called")
        if not path.is_file():  # a pipe would be waited for, a device would never end
            hint = "it is a folder" if path.is_dir() else "it is a pipe or a device"
            raise InputError(setting, path, "a readable file", hint)
        with path.open("rb") as file:
            check_size(path, path.stat().st_size, setting)
            return file.read(most)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a path with a null character is a ValueError
        raise InputError(setting, path, "a readable file", getattr(error, "strerror", None) or str(error)) from None


def read_text(path: Path, setting: str = "data.path", encoding: str | None = None) -> str:
    """The text of a file that a setting has named, without a byte order mark; gzip is unpacked.

    The encoding, as Python calls it, is by default that of the byte order mark, else UTF-8, else cp1252.

    Raises:
        InputError: It is missing, is no regular file, cannot be read or held, or is no text.
    """
    content = read_bytes(path, setting)
    if content.startswith(_GZIP):
        content = _unpacked(path, content, setting)
    kind = _kind(content)
    if kind and kind != PACKED_AS[_UNIVERSAL]:
        raise InputError(setting, path, "a text file", f"it is {kind}: unpack it, or {_SAVE_AS}")
    given = encoding or next((name for mark, name in _MARKS.items() if content.startswith(mark)), _wide(content))
    names = (given,) if given else ("utf-8", _FALLBACK)
    for name in names if given or b"\0" not in content else ():
        with suppress(UnicodeError, LookupError):
            return content.decode(name)
    hint = f"it is in another encoding, or no text: give data.format.encoding, or {_SAVE_AS}"
    raise InputError(setting, path, f"text in {' or '.join(names)}", hint)


def looks_like_text(content: bytes) -> bool:
    """Whether bytes that a file begins with may be text, packed by gzip perhaps."""
    marked = content.startswith((_GZIP, *_MARKS)) or _wide(content) is not None
    return marked or (bool(content) and not _kind(content) and min(content) >= 9)


def _wide(content: bytes) -> str | None:
    """UTF-16 without a mark, where every second byte of the first ones is 0."""
    start = content[:64]
    odd, even = start[1::2], start[::2]
    if len(start) > 3 and not any(odd) and all(even):
        return "utf-16-le"
    return "utf-16-be" if len(start) > 3 and not any(even) and all(odd) else None


def check_size(path: Path, size: float, setting: str = "data.path") -> None:
    """Refuse more bytes, packed or not, than a record that a setting has named may have."""
    most = of_this_machine() // PART_OF_MEMORY
    if size > most:
        hint = "the record has to fit into memory: cut the file, or average it down"
        raise InputError(setting, path, f"a file of at most {most / 2**30:.3g} GiB", hint)


def other_format(path: Path, content: bytes, expected: str) -> InputError:
    """What to tell of a file that is not ``expected``, such as ``a MAT file``, from its first bytes."""
    kind = _kind(content)
    if not kind and min(content, default=0) >= 9:  # no control characters but tabs and ends of lines
        kind = "text (data=csv?)"
    hint = f"it is {kind}" if kind else "another format, or damaged?"
    return InputError("data.path", path, expected, hint if content else "it is empty")


def damaged(path: Path, expected: str, reason: str) -> InputError:
    """What to tell of a file that a library cannot read to its end."""
    return InputError("data.path", path, f"{expected} that is whole", f"damaged or cut off? {reason}")


def _kind(content: bytes) -> str:
    return next((kind for start, kind in PACKED_AS.items() if content.startswith(start)), "")


def _unpacked(path: Path, content: bytes, setting: str) -> bytes:
    """What gzip has packed, which may be no more than any file."""
    try:
        with gzip.GzipFile(fileobj=BytesIO(content)) as packed:
            unpacked = packed.read(of_this_machine() // PART_OF_MEMORY + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(setting, path, "a gzip file that is whole", f"damaged or cut off? {error}") from None
    check_size(path, len(unpacked), setting)
    return unpacked
