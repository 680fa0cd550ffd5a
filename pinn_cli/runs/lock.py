"""One process at a time in a run's or a sweep's directory, or wherever else: a second one waits until the first ends.

The operating system holds the lock for an open file and gives it back when the process ends, however it ends, so that
nothing is left over from a kill. Between machines it holds where the file system's locks do: NFS, GPFS, Lustre mounted
with `flock`. Where a file system has none, the run says so and goes on without.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from pinn_cli.runs.reading import small_text

log = logging.getLogger(__name__)

# Of a run and of a sweep, whose directory a job may have for its own.
FILE, SWEEP_FILE = "run.lock", "sweep.lock"
EVERY_S = 1.0
# What a file system without locks answers.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)


@contextmanager
def held(directory: Path, name: str = FILE) -> Iterator[None]:
    """Keep other processes out of a run's or a sweep's directory during the block, once those before have left it.

    Args:
        directory: Exists.
        name: Of the file in it that says who is in there while the block runs.
    """
    with locked(directory / name, f"waiting for another process to leave {directory}", EVERY_S):
        yield


@contextmanager
def if_free(directory: Path) -> Iterator[bool]:
    """Whether no other process is in a run's or a sweep's directory, or comes in meanwhile: see :func:`held`."""
    from filelock import FileLock, Timeout

    with ExitStack() as locks:
        try:
            for name in (FILE, SWEEP_FILE):
                locks.enter_context(FileLock(directory / name, blocking=False, fallback_to_soft=False))
            free = True
        except Timeout:
            free = False
        except OSError:  # a file system without locks
            free = True
        yield free


@contextmanager
def locked(file: Path, waiting: str = "", every_s: float = 0.1) -> Iterator[None]:
    """Have one process at a time in the block, of those that name the same file.

    Args:
        file: Made where it is missing, and removed at the end; its folder exists. While the block runs it says whose.
        waiting: What the log is told where the process has to wait; empty: nothing.
        every_s: Seconds from one look to the next.
    """
    from filelock import FileLock, Timeout  # not for --help

    # No marker in place of a lock, which a kill would leave behind.
    lock = FileLock(file, thread_local=False, fallback_to_soft=False)
    try:
        try:
            lock.acquire(blocking=False)
        except Timeout:
            if waiting:
                owner = ""  # as it wrote it: for a person to read, and nothing depends on it
                with suppress(OSError):  # it has left meanwhile
                    owner = small_text(file)
                log.warning("%s: %s", waiting, owner or "one that has just begun")
            while not lock.is_locked:
                with suppress(FileNotFoundError):  # who was in there took the folder along: it is made anew
                    lock.acquire(poll_interval=every_s)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        file.unlink(missing_ok=True)
        log.warning("%s is on a file system without locks: have no two processes write there", file.parent)
    try:
        if lock.is_locked:
            job = {"slurm_job": os.environ["SLURM_JOB_ID"]} if "SLURM_JOB_ID" in os.environ else {}
            with suppress(OSError):  # on a full disk nobody learns who is in there
                file.write_text(json.dumps({"host": socket.gethostname(), "pid": os.getpid(), **job}), encoding="utf-8")
        yield
    finally:
        if lock.is_locked:
            with suppress(OSError):  # while it is locked: whoever has opened it meanwhile finds out and opens a new one
                file.unlink()
            lock.release()
