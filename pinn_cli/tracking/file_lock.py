"""One process at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def alone(beside: Path | None) -> Iterator[None]:
    """Have one process at a time in the block, of those that name the same file.

    Args:
        beside: The lock lies beside it, as ``.NAME.lock``; None: no lock. Where the system has no such locks (Windows)
            the block runs as it is.
    """
    try:
        import fcntl
    except ImportError:
        beside = None
    if beside is None:
        yield
        return
    beside.parent.mkdir(parents=True, exist_ok=True)
    with beside.with_name(f".{beside.name}.lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # until the file is closed, however the process ends
        yield
