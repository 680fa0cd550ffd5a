"""The formats that the program reads, and which of them a file's suffix tells."""

from __future__ import annotations

from pathlib import Path

from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.csv import CsvFormat

# The first that has a suffix is the one that it tells.
FORMATS: tuple[type[FileFormat], ...] = (CsvFormat,)


def format_of(path: Path, chosen: FileFormat) -> FileFormat:
    """The chosen format, unless the file's suffix is none of its own and that of another.

    Args:
        path: Of the file.
        chosen: By ``data=...``.
    """
    suffix = path.suffix.lower()
    if suffix in chosen.suffixes:
        return chosen
    return next((other() for other in FORMATS if suffix in other.suffixes), chosen)
