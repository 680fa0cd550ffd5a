"""Which cores a worker of joblib runs on: each has its own share of them."""

from __future__ import annotations

import os
import socket

from pinn_cli.runs.cores import usable_cores

# One per process, kept open: the system gives the share back when the process ends, however it ends.
_claim: socket.socket | None = None


def shares(cores: list[int], workers: int) -> list[list[int]]:
    """Divide cores among workers, neighbouring ones to the same; with more workers than cores some share one."""
    count = len(cores)
    if workers > count:
        return [[cores[worker % count]] for worker in range(workers)]
    return [cores[worker * count // workers : (worker + 1) * count // workers] for worker in range(workers)]


def jobs_at_once(threads: int) -> int:
    """How many jobs of that many threads the cores can run at once, at least one."""
    return max(1, len(usable_cores()) // max(1, threads))


def pin(workers: int) -> list[int]:
    """Keep this process, one of so many workers of joblib's, to the first share that none of its siblings has.

    Where the system cannot (it is not Linux), or no share is left, nothing happens. Once in a process is enough.

    Returns:
        The cores that it runs on.
    """
    global _claim  # noqa: PLW0603
    if _claim is not None or not hasattr(os, "sched_setaffinity"):
        return usable_cores()
    for share, cores in enumerate(shares(usable_cores(), workers)):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0pinn-run cores {os.getppid()} {share}")  # an abstract name, which dies with its owner
        except OSError:
            claim.close()
            continue
        _claim = claim
        os.sched_setaffinity(0, cores)
        break
    return usable_cores()
