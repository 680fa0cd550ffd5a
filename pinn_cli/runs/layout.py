"""Which release reads a file: each file that is read back has the number of its layout and the release that wrote it.

A reader takes every layout up to the one that it writes. A later one is refused: it may mean something else.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pinn_cli.runs.identity import package_version
from pinn_cli.settings.errors import InputError

NUMBER, WRITER = "format", "written_by"


def this_release() -> str:
    """Name and version of this package."""
    return f"pinn-cli {package_version('pinn-cli') or 'unknown'}"


def stamp(number: int) -> dict[str, Any]:
    """What a file says of itself that is written in the layout of that number."""
    return {NUMBER: number, WRITER: this_release()}


def check_layout(content: Mapping[str, Any], known: int, file: Path, oldest: int = 1) -> None:
    """Refuse a file of a later release.

    Args:
        content: Of the file; without a number it is as old as files can be.
        known: The last layout that is known here.
        file: Which.
        oldest: The first one.

    Raises:
        InputError: It is none of these; the release that reads it is told.
    """
    number = content.get(NUMBER, oldest)
    if isinstance(number, int) and oldest <= number <= known:
        return
    readable = f"of format {known}" if oldest == known else f"of format {oldest} to {known}"
    writer = str(content.get(WRITER, "another release")).encode("unicode_escape").decode()
    hint = f"{writer} wrote it and reads it; this is {this_release()}"
    raise InputError(str(file), f"format {number!a}", readable, hint)
