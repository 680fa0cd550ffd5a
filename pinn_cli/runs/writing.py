"""Files that are there whole or not at all.

Every file of a run is written beside its place and then renamed into it, so that an interrupted run leaves no
half-written table that a sweep would read as a result.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a path beside ``path``; rename it onto ``path`` when the block ends, remove it when the block fails.

    The folder is created where it is missing. Readers see the old file or the new one, never a part of it
    (``os.replace`` is atomic within a file system, and the two lie in one folder).
    """
    place = Path(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    # The suffix is kept: some writers choose their format by it. The process id keeps two jobs of a sweep apart.
    beside = place.with_name(f".{place.stem}.{os.getpid()}.partial{place.suffix}")
    try:
        yield beside
        os.replace(beside, place)
    finally:
        beside.unlink(missing_ok=True)


def write_text(text: str, path: Path | str) -> Path:
    """Write ``text`` as UTF-8 with one newline at its end."""
    with replacing(path) as beside:
        beside.write_text(text.rstrip("\n") + "\n", encoding="utf-8")
    return Path(path)


def write_table(table: pandas.DataFrame, path: Path | str) -> Path:
    """Write a table as CSV without an index; cells that are NaN or None are empty; ten significant digits."""
    with replacing(path) as beside:
        table.to_csv(beside, index=False, float_format="%.10g", lineterminator="\n")
    return Path(path)


def write_json(content: Mapping[str, object], path: Path | str) -> Path:
    """Write ``content`` as JSON that any reader accepts: NumPy values become plain, NaN and infinities become null."""
    return write_text(json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False), path)


def _plain(value: object) -> object:
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
