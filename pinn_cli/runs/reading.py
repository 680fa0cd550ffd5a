"""The door for what lies in a directory that somebody else may have made: its files, and what is printed of them.

A file is opened if it is a regular one of a size that such files have, and what it holds is checked once, here, against
a type: a dataclass or a `TypedDict` that stands where the file is written. Its texts come in as they can be printed.
Each such file has the number of its layout and the release that wrote it. A reader takes every layout up to the one
that is written here, and refuses a later one: it may mean something else. Nothing slow is imported here.
"""

from __future__ import annotations

import json
import math
import stat
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from io import StringIO
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints, is_typeddict
from zipfile import ZipFile

from pinn_cli.runs.identity import package_version
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import pandas

T = TypeVar("T")

# Far more than any of ours has; a device or a pipe has no end. Tables and histories have a row for each iteration.
MOST_BYTES, MOST_OF_TABLE = 64 * 2**20, 256 * 2**20
# Of arrays when unpacked: a file that somebody made to be far larger than it looks is not read.
MOST_UNFOLDED = 16 * MOST_BYTES
NUMBER, WRITER = "format", "written_by"
# Columns of a table: a shape of a mode is the widest that there is.
MOST_COLUMNS = 100_000
_TYPE_NAMES: dict[Any, str] = {
    str: "text", int: "a whole number", float: "a number", bool: "true or false", dict: "settings", list: "a list",
    NoneType: "null",
}  # fmt: skip


class DamagedError(ValueError):
    """A file that is none, or not as this program writes it: which one, and what is wrong with it."""

    def __init__(self, file: Path, reason: str) -> None:
        super().__init__(f"{file.name} cannot be read: {printable(reason).partition(chr(10))[0]}")


def this_release() -> str:
    """Name and version of this package."""
    return f"pinn-cli {package_version('pinn-cli') or 'unknown'}"


def stamp(number: int) -> dict[str, Any]:
    """What a file says of itself that is written in the layout of that number."""
    return {NUMBER: number, WRITER: this_release()}


def check_layout(content: Mapping[str, Any], newest: int, file: Path, oldest: int = 1) -> None:
    """Refuse a file in a later layout than the ``newest`` one known here; one without a number is as old as can be.

    The release that reads it is told.
    """
    number = content.get(NUMBER, oldest)
    if isinstance(number, int) and oldest <= number <= newest:
        return
    readable = f"of format {newest}" if oldest == newest else f"of format {oldest} to {newest}"
    writer = str(content.get(WRITER, "another release")).encode("unicode_escape").decode()
    hint = f"{writer} wrote it and reads it; this is {this_release()}"
    raise InputError(str(file), f"format {number!a}", readable, hint)


def check_regular(file: Path, most: float = MOST_BYTES) -> None:
    """See to it that a file can be read to its end.

    Raises:
        OSError: It is not there, is a device, a pipe or a folder, or has more bytes than ``most``.
    """
    status = file.stat()
    if not stat.S_ISREG(status.st_mode) or status.st_size > most:
        raise OSError(f"{file.name} is no {'regular' if not stat.S_ISREG(status.st_mode) else 'small'} file")


def small_text(file: Path, most: float = MOST_BYTES) -> str:
    """Text of a file, where :func:`check_regular` finds no fault with it."""
    check_regular(file, most)
    return file.read_text(encoding="utf-8", errors="replace")


def read_json(file: Path, kind: type[T], layout: int | None = None) -> T:
    """What a file of JSON holds.

    Args:
        file: To be read.
        kind: What it must be: a dataclass, whose other keys are left out, or a `TypedDict`, whose other keys may be
            anything.
        layout: The last one that is known here; None: the file has no number of its own.

    Raises:
        FileNotFoundError: There is no such file.
        InputError: A later release wrote it.
        DamagedError: It is none of ours.
    """
    try:
        content = json.loads(small_text(file))
        if layout is not None and isinstance(content, dict):
            check_layout(content, layout, file)
        return checked(content, kind)
    except (FileNotFoundError, InputError):
        raise
    except RecursionError:
        raise DamagedError(file, "it is nested without end") from None
    except (OSError, ValueError) as error:
        raise DamagedError(file, str(error)) from None


def read_table(file: Path, numbers: Sequence[str] = (), texts: Sequence[str] = ()) -> pandas.DataFrame:
    """A table as this program writes it, with these columns of numbers, which may be empty, and these of texts.

    Raises:
        FileNotFoundError: There is no such file.
        DamagedError: It is no such table.
    """
    import pandas as pd

    try:
        text = small_text(file, MOST_OF_TABLE)
        if text.partition("\n")[0].count(",") > MOST_COLUMNS:
            raise ValueError(f"it has more than {MOST_COLUMNS} columns")
        table = pd.read_csv(StringIO(text), low_memory=False)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise DamagedError(file, str(error)) from None
    for name in (*numbers, *texts):
        if name not in table:
            raise DamagedError(file, f"it has no column {name}")
    for name in numbers:
        if table[name].dtype.kind not in "iuf" and table[name].notna().any():
            raise DamagedError(file, f"column {name} holds other things than numbers")
    return table


def read_arrays(file: Path, without: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Arrays by name, of an archive as `numpy.savez` writes it: numbers and texts, nothing that is executed.

    Those whose names begin with one of ``without`` are left unread.

    Raises:
        DamagedError: It is no such file, or unfolds to more than any of ours does.
    """
    import numpy as np

    try:
        check_regular(file, MOST_UNFOLDED)
        with ZipFile(file) as archive:
            if sum(member.file_size for member in archive.infolist()) > MOST_UNFOLDED:
                raise ValueError("it is larger than any of ours")
        with np.load(file, allow_pickle=False) as content:
            return {name: content[name] for name in content.files if not name.startswith(without)}
    except Exception as error:  # of archives and arrays that may be anything
        said = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise DamagedError(file, said) from error


@contextmanager
def undamaged(setting: str, directory: Path) -> Iterator[None]:
    """Tell of files of a directory that are read in the block, and are damaged or do not fit together, as of any input.

    Raises:
        InputError: Naming the setting that named the directory.
    """
    try:
        yield
    except InputError:
        raise
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        reason = str(error) if isinstance(error, DamagedError) else f"{type(error).__name__}: {error}"
        raise InputError(setting, directory, "a directory as pinn-run left it", reason) from error


def checked(value: Any, kind: Any, place: str = "") -> Any:
    """A value that was read, plain as JSON has it, if it is of a type; its texts as they can be printed.

    Args:
        value: Mappings, lists, texts, numbers, Booleans and None.
        kind: A type, one with parameters, a `Literal`, a union, a dataclass or a `TypedDict`; `Any`.
        place: Of the value, for errors.

    Raises:
        ValueError: It is of none; names the place.
    """
    origin, args = get_origin(kind), get_args(kind)
    if origin in (UnionType, Union):
        kind = NoneType if value is None and NoneType in args else next(arg for arg in args if arg is not NoneType)
        return checked(value, kind, place)
    if origin is Literal:
        if value not in args:
            raise ValueError(f"{place} is none of {', '.join(map(str, args))}")
        return value
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        if not -math.inf < value < math.inf or abs(value) > 1e300:
            raise ValueError(f"{place} is beyond any number")
        return value
    fields = _fields(kind)
    expected = dict if fields is not None else list if origin is tuple else origin or kind
    if kind is not Any and not (isinstance(value, expected) and isinstance(value, bool) == (expected is bool)):
        is_ = _TYPE_NAMES.get(type(value), "of another kind")
        raise ValueError(f"{place or 'its content'} is {is_}, not {_TYPE_NAMES.get(expected, str(expected))}")
    if isinstance(value, str):
        return printable(value)
    if origin is tuple and len(value) != len(args):
        raise ValueError(f"{place} has {len(value)} entries, not {len(args)}")
    if origin is tuple:
        return [checked(item, part, f"{place}[{i}]") for i, (item, part) in enumerate(zip(value, args, strict=True))]
    if isinstance(value, list):
        return [checked(item, args[0] if args else Any, f"{place}[{i}]") for i, item in enumerate(value)]
    if not isinstance(value, Mapping):
        return value
    within = f"{place}." if place else ""
    lacking = [name for name in getattr(kind, "__required_keys__", ()) if name not in value]
    lacking += [name for name in getattr(kind, "__match_args__", ()) if name not in value and not hasattr(kind, name)]
    if lacking:
        raise ValueError(f"{within}{lacking[0]} is missing")
    kinds = {name: (fields or {}).get(name, args[1] if args else Any) for name in value}
    parts = {printable(str(name)): checked(part, kinds[name], f"{within}{name}") for name, part in value.items()}
    if fields is None or is_typeddict(kind):
        return parts
    return kind(**{name: part for name, part in parts.items() if name in fields})


@cache
def _fields(kind: Any) -> dict[str, Any] | None:
    """Types by name of a dataclass or a `TypedDict`; None of anything else."""
    return get_type_hints(kind) if is_typeddict(kind) or hasattr(kind, "__dataclass_fields__") else None


def printable(text: str) -> str:
    r"""A text whose control characters are written out, as ``\x1b``: files of others may hold some for a terminal."""
    if text.isprintable():
        return text
    controls = {c for c in text if c not in "\n\t" and unicodedata.category(c).startswith("C")}
    return text.translate({ord(c): c.encode("unicode_escape").decode() for c in controls})
