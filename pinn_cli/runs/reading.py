"""What somebody else may have made: small files of a directory, and what is printed of them."""

from __future__ import annotations

import stat
import unicodedata
from pathlib import Path

# Far more than any of ours has; a device or a pipe has no end.
MOST_BYTES = 64 * 2**20


def small_text(file: Path) -> str:
    """Text of a regular file.

    Raises:
        OSError: It cannot be read, is a device, a pipe or a folder, or larger than anything that was written here.
    """
    status = file.stat()
    if not stat.S_ISREG(status.st_mode) or status.st_size > MOST_BYTES:
        raise OSError(f"{file.name} is no small file")
    return file.read_text(encoding="utf-8", errors="replace")


def printable(text: str) -> str:
    r"""A text whose control characters are written out, as ``\x1b``: files of others may hold some for a terminal."""
    return "".join(
        character.encode("unicode_escape").decode()
        if character not in "\n\t" and unicodedata.category(character).startswith("C")
        else character
        for character in text
    )
