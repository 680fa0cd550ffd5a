"""The text of a file of numbers: what is no text is refused before anyone looks for numbers in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.runs.memory import of_this_machine
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

# How files begin that spreadsheets and archivers write.
_PACKED = {
    b"\x1f\x8b": "gzip",
    b"PK\x03\x04": "a zip archive or a spreadsheet",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"\x28\xb5\x2f\xfd": "Zstandard",
    b"\xd0\xcf\x11\xe0": "a spreadsheet",
    b"\x89HDF": "HDF5",
    b"MATLAB 5.0": "a MAT file",
}
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_SAVE_AS = "save it as text with comma-separated values, in UTF-8"
# Of the memory, at most this part: text, cells and numbers of a file take some ten times its size.
_PART_OF_MEMORY = 16


def read_text(path: Path, setting: str = "data.path") -> str:
    """The text of a file, without a byte order mark.

    Args:
        path: Of the file.
        setting: That named it, for errors.

    Raises:
        InputError: It is missing, is no regular file, cannot be read or held, is packed, or is no UTF-8.
    """
    data = _read_bytes(path, setting)
    for beginning, kind in _PACKED.items():
        if data.startswith(beginning):
            raise InputError(setting, path, "a text file", f"it is {kind}: unpack it, or {_SAVE_AS}")
    if path.suffix.lower() in (".gz", ".zip", ".bz2", ".xz", ".zst"):
        raise InputError(setting, path, "a text file", f"unpack it, and {_SAVE_AS}")
    if data.startswith(_UTF_16):
        raise InputError(setting, path, "UTF-8 text", f"it is UTF-16: {_SAVE_AS}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        place, byte = f"{path.name}, line {line}", f"byte 0x{error.object[error.start]:02x}"
        raise InputError(place, byte, "UTF-8 text", f"the file is in another encoding: {_SAVE_AS}") from None


def _read_bytes(path: Path, setting: str) -> bytes:
    try:
        if not path.exists():
            hint = "a relative path starts where pinn-run was called"
            raise InputError(setting, path, "a file that exists", hint)
        if not path.is_file():  # a pipe would be waited for, a device would never end
            hint = "it is a folder" if path.is_dir() else "it is a pipe or a device"
            raise InputError(setting, path, "a readable text file", hint)
        size, most = path.stat().st_size, of_this_machine() // _PART_OF_MEMORY
        if size > most:
            hint = "the record has to fit into memory: cut the file, or average it down"
            raise InputError(setting, path, f"a file of at most {most / 2**30:.3g} GiB", hint)
        return path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        # A path with a null character is a ValueError.
        hint = getattr(error, "strerror", None) or str(error)
        raise InputError(setting, path, "a readable text file", hint) from None
