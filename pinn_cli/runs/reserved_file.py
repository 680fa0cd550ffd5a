"""Files whose place on the disk is taken before a library writes them that does not outlive a full disk."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.runs.writing import replacing

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer


@contextmanager
def replacing_by_reserved(path: Path | str, size: int) -> Iterator[io.IOBase]:
    """Yield an empty file that may grow to ``size`` bytes; it is renamed onto ``path`` when the block ends.

    HDF5 ends the process where its disk is full. So the disk is asked for the bytes before HDF5 begins. Where the
    system cannot be asked, the file is in memory until it is whole.

    Raises:
        WriteError: The disk does not take it; what was there before stays.
    """
    with replacing(path) as beside:
        if not hasattr(os, "posix_fallocate"):
            content = io.BytesIO()
            yield content
            beside.write_bytes(content.getbuffer())
            return
        with _Reserved(beside, size) as file:
            yield file
            file.fit()


class _Reserved(io.RawIOBase):
    """A file with room on the disk behind its end.

    Args:
        path: Of the file.
        size: Bytes that it may grow to.

    Raises:
        OSError: The disk has no room for it.
    """

    def __init__(self, path: Path, size: int) -> None:
        super().__init__()
        self._file = path.open("w+b", buffering=0)
        self._end = 0
        try:
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError:
            self._file.close()
            raise

    def fit(self) -> None:
        """Give back the room behind the end."""
        self._file.truncate(self._end)

    def close(self) -> None:
        """See :class:`io.IOBase`."""
        self._file.close()
        super().close()

    def readable(self) -> bool:
        """See :class:`io.IOBase`."""
        return True

    def writable(self) -> bool:
        """See :class:`io.IOBase`."""
        return True

    def seekable(self) -> bool:
        """See :class:`io.IOBase`."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """See :class:`io.IOBase`; from the end means from the last byte that was written."""
        if whence == os.SEEK_END:
            return self._file.seek(self._end + offset)
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """See :class:`io.IOBase`."""
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """See :class:`io.IOBase`; the room stays."""
        self._end = self.tell() if size is None else size
        return self._end

    def readinto(self, buffer: WriteableBuffer) -> int:
        """See :class:`io.RawIOBase`."""
        view = memoryview(buffer).cast("B")
        left = max(0, self._end - self.tell())
        return self._file.readinto(view[:left]) or 0

    def write(self, buffer: ReadableBuffer) -> int:
        """See :class:`io.RawIOBase`; all of it is written."""
        view = memoryview(buffer).cast("B")
        written = 0
        while written < len(view):
            written += self._file.write(view[written:]) or 0
        self._end = max(self._end, self.tell())
        return written
