"""One process at a time in a run's directory, or wherever else: a second one waits until the first has ended.

The operating system holds the lock for an open file (`flock`) and gives it back when the process ends, however it ends,
so that nothing is left over from a kill. Between machines it holds where the file system's locks do: NFS, GPFS, Lustre
mounted with `flock`. Where a file system has none, the run says so and goes on without.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

if sys.platform != "win32":
    import fcntl

log = logging.getLogger(__name__)

FILE = "run.lock"
EVERY_S = 1.0
# What a file system without locks answers.
_NONE = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)


@contextmanager
def held(directory: Path) -> Iterator[None]:
    """Keep other processes out of a run's directory during the block, once those before have left it.

    Args:
        directory: Exists. While the block runs, its `run.lock` says who is in there.
    """
    with locked(directory / FILE, f"waiting for another process to leave {directory}", EVERY_S):
        yield


@contextmanager
def locked(file: Path, waiting: str = "", every_s: float = 0.1) -> Iterator[None]:
    """Have one process at a time in the block, of those that name the same file.

    Args:
        file: Made where it is missing, and removed at the end; its folder exists. While the block runs it says whose.
        waiting: What the log is told where the process has to wait; empty: nothing.
        every_s: Seconds from one look to the next.
    """
    descriptor = _acquire(file, waiting, every_s)
    try:
        yield
    finally:
        if descriptor is not None:
            with suppress(OSError):  # while it is locked: whoever has opened it meanwhile finds out and opens a new one
                file.unlink()
            os.close(descriptor)


def _acquire(file: Path, waiting: str, every_s: float) -> int | None:
    """The locked file, or None where there are no locks."""
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            taken = _try(descriptor)
        except OSError as error:
            os.close(descriptor)
            if error.errno not in _NONE:
                raise
            file.unlink(missing_ok=True)
            log.warning("%s is on a file system without locks: have no two processes write there", file.parent)
            return None
        if taken and _is_there(file, descriptor):
            break
        if not taken and waiting:
            log.warning("%s: %s", waiting, _owner(descriptor))
            waiting = ""
        os.close(descriptor)
        if not taken:
            time.sleep(every_s)
    os.ftruncate(descriptor, 0)
    os.write(descriptor, json.dumps(_this_process()).encode())
    return descriptor


def _try(descriptor: int) -> bool:
    if sys.platform == "win32":
        raise OSError(errno.ENOSYS, "no flock")
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_there(file: Path, descriptor: int) -> bool:
    """Whether the file was not removed, by whoever held it, between its opening and its locking."""
    try:
        return os.path.samestat(file.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _owner(descriptor: int) -> str:
    """As the owner wrote it: for a person to read, and nothing depends on it."""
    return os.pread(descriptor, 4096, 0).decode(errors="replace") or "one that has just begun"


def _this_process() -> dict[str, object]:
    job = os.environ.get("SLURM_JOB_ID")
    return {"host": socket.gethostname(), "pid": os.getpid(), **({"slurm_job": job} if job else {})}
