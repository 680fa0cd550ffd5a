"""Files that are there whole or not at all.

Every file of a run is written beside its place and then renamed into it, so that an interrupted run leaves no
half-written table that a sweep would read as a result.
"""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas

# Names of files that are being written: `.fitness.4711.partial.csv`.
PARTIAL = re.compile(r"\..+\.\d+\.partial(\.\w+)?")
# The folders of a run's directory that its files lie in.
FOLDERS = (".hydra", "figures", "chains")


# What the system answers where a disk, or a place on it, takes no file.
_DISK = {
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.ENAMETOOLONG,
    errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ELOOP, errno.EMFILE, errno.ENFILE, errno.ESTALE,
}  # fmt: skip

# What an error of the system's is about that names no file: standard output, as a rule.
OUTPUT = "the output"


class WriteError(RuntimeError):
    """A file that the disk does not take: it is full, or its folder is gone or forbidden.

    Attributes:
        path: Of the file.
        reason: In the system's words.
    """

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"{path} cannot be written: {reason}")
        self.path, self.reason = path, reason

    def __reduce__(self) -> tuple[type[WriteError], tuple[Path | str, str]]:
        # As `InputError`: it crosses process borders in sweeps.
        return type(self), (self.path, self.reason)


def refused_by_disk(error: BaseException) -> WriteError | None:
    """What to tell of an error of the system's that is about the disk; None of any other."""
    if isinstance(error, OSError) and error.errno in _DISK:
        return WriteError(error.filename or OUTPUT, error.strerror or str(error))
    return None


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a path beside ``path``; rename it onto ``path`` when the block ends, remove it when the block fails.

    The folder is created where it is missing. Readers see the old file or the new one, never a part of it
    (``os.replace`` is atomic within a file system, and the two lie in one folder).

    Raises:
        WriteError: The disk does not take it; what was there before stays.
    """
    place = Path(path)
    # The suffix is kept: some writers choose their format by it. The number keeps processes apart, on any machine.
    temporary = place.with_name(f".{place.stem}.{int.from_bytes(os.urandom(6))}.partial{place.suffix}")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, place)
    except OSError as error:
        raise WriteError(place, error.strerror or str(error)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def replacing_by_large(path: Path | str, size: int) -> Iterator[Path]:
    """:func:`replacing`, once the disk has been asked for room for ``size`` bytes: HDF5 does not outlive a full disk.

    Raises:
        WriteError: It has not as much; what was there before stays.
    """
    with replacing(path) as temporary:
        if hasattr(os, "posix_fallocate"):
            with temporary.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, size)
        yield temporary


def tidy(directory: Path) -> None:
    """Remove what a killed process left half-written in a run's directory and its folders."""
    for folder in (directory, *(directory / name for name in FOLDERS)):
        if folder.is_dir() and not folder.is_symlink():
            for file in folder.iterdir():
                if PARTIAL.fullmatch(file.name) and file.is_file():
                    file.unlink(missing_ok=True)


def write_text(text: str, path: Path | str) -> Path:
    """Write ``text`` as UTF-8 with one newline at its end."""
    with replacing(path) as temporary:
        temporary.write_text(text.rstrip("\n") + "\n", encoding="utf-8")
    return Path(path)


def write_bytes(content: bytes | memoryview, path: Path | str) -> Path:
    """Write a file whose bytes are in memory already, as those of libraries that do not outlive a full disk."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return Path(path)


def content_of(file: Path) -> bytes | None:
    """Of a file; None where there is none."""
    return file.read_bytes() if file.is_file() else None


def put_back(file: Path, content: bytes | None) -> None:
    """Have a file be as it was when :func:`content_of` said this."""
    if content is None:
        if file.is_file() and not file.is_symlink():  # a pipe or a link there is somebody's
            file.unlink()
    elif content_of(file) != content:
        write_bytes(content, file)


def write_table(table: pandas.DataFrame, path: Path | str) -> Path:
    """Write a table as CSV without an index; cells that are NaN or None are empty; ten significant digits."""
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False, float_format="%.10g", lineterminator="\n")
    return Path(path)


def write_json(content: Mapping[str, object], path: Path | str) -> Path:
    """Write ``content`` as JSON that any reader accepts: NumPy values become plain, NaN and infinities become null."""
    return write_text(json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False), path)


def _plain(value: object) -> object:
    import numpy as np  # not above: `pinn-run --help` reads this module too

    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"run.json cannot hold {value!r} of type {type(value).__name__}")
