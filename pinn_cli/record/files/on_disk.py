"""A file before anyone reads it: is it there, is it a file, does it fit into memory, what does it begin with."""

from __future__ import annotations

from pathlib import Path

from pinn_cli.runs.memory import of_this_machine
from pinn_cli.settings.errors import InputError

# Of the memory, at most this part: text, cells and numbers of a file take some ten times its size.
PART_OF_MEMORY = 16
# How files begin whose names do not always say what they are.
BEGINNINGS = {
    b"\x1f\x8b": "gzip",
    b"PK\x03\x04": "a zip archive or a spreadsheet",
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
    b"    -1": "a universal file (data=uff)",
}


def read_bytes(path: Path, setting: str = "data.path", most: int = -1) -> bytes:
    """All of a file, or its first ``most`` bytes.

    Args:
        path: Of the file.
        setting: That named it, for errors.
        most: Bytes to read; -1: all.

    Raises:
        InputError: It is missing, is no regular file, cannot be read, or is larger than memory can hold.
    """
    try:
        if not path.exists():
            raise InputError(setting, path, "a file that exists", "a relative path starts where pinn-run was called")
        if not path.is_file():  # a pipe would be waited for, a device would never end
            hint = "it is a folder" if path.is_dir() else "it is a pipe or a device"
            raise InputError(setting, path, "a readable file", hint)
        check_size(path, path.stat().st_size, setting)
        with path.open("rb") as file:
            return file.read(most)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a path with a null character is a ValueError
        raise InputError(setting, path, "a readable file", getattr(error, "strerror", None) or str(error)) from None


def check_size(path: Path, size: float, setting: str = "data.path") -> None:
    """Refuse more bytes than a record may have, packed or not.

    Raises:
        InputError: Naming the setting.
    """
    most = of_this_machine() // PART_OF_MEMORY
    if size > most:
        hint = "the record has to fit into memory: cut the file, or average it down"
        raise InputError(setting, path, f"a file of at most {most / 2**30:.3g} GiB", hint)


def other_format(path: Path, content: bytes, expected: str) -> InputError:
    """What to tell of a file that is not what it was taken for.

    Args:
        path: Of the file.
        content: Its first bytes.
        expected: What it should be, such as ``a MAT file``.
    """
    found = next((kind for start, kind in BEGINNINGS.items() if content.startswith(start)), "")
    if not found and min(content, default=0) >= 9:  # no control characters but tabs and ends of lines
        found = "text (data=csv?)"
    hint = f"it is {found}" if found else "another format, or damaged?"
    return InputError("data.path", path, expected, hint if content else "it is empty")


def damaged(path: Path, expected: str, reason: str) -> InputError:
    """What to tell of a file that a library cannot read to its end."""
    return InputError("data.path", path, f"{expected} that is whole", f"damaged or cut off? {reason}")
