"""A file before anyone looks for numbers: is it there, does it fit into memory, what is it, and which text holds it."""

from __future__ import annotations

import codecs
import gzip
import zlib
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from pinn_cli.runs.machine import of_this_machine
from pinn_cli.settings.errors import InputError

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
