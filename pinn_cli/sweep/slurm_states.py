"""Which tasks are queued, and what became of others, as `sacct` tells, or `squeue` where no accounts are kept."""

from __future__ import annotations

import getpass
import subprocess
from pathlib import Path

from submitit import SlurmJob
from submitit.slurm.slurm import SlurmInfoWatcher

# What is made of a task that the cluster has forgotten, as it does some minutes after its end.
FORGOTTEN = "ENDED"
# States from which no task comes back. submitit takes every state for one that it does not know, such as SUSPENDED.
_FINAL = (
    "BOOT_FAIL",
    "CANCELLED",
    "COMPLETED",
    "DEADLINE",
    "FAILED",
    "NODE_FAIL",
    "OUT_OF_MEMORY",
    "TIMEOUT",
    FORGOTTEN,
)
_ASKED_EVERY_S = 60


class AccountsWatcher(SlurmInfoWatcher):
    """Asks `sacct`, as submitit does, and knows which tasks have ended."""

    def is_done(self, job_id: str, mode: str = "standard") -> bool:
        """Whether a task has ended; one that was preempted may be requeued, or not, as its partition has it."""
        state = self.get_state(job_id, mode=mode).upper()
        return state.startswith(_FINAL) or (state.startswith("PREEMPTED") and not _is_queued(job_id))


class QueueWatcher(AccountsWatcher):
    """Asks `squeue`, which lists the tasks that are queued, run, or ended not long ago."""

    def _make_command(self) -> list[str] | None:
        if not self._registered - self._finished:
            return None
        listed = ["--noheader", "--array", "--states=all", f"--user={getpass.getuser()}"]
        return ["squeue", *listed, "--format=%i|%T"]

    def read_info(self, string: bytes | str) -> dict[str, dict[str, str]]:
        """The state of each task that was registered, by its name (`17_3`)."""
        text = string if isinstance(string, str) else string.decode()
        states = dict(line.split("|", 1) for line in text.split())
        waited_for = self._registered - self._finished
        return {task: {"JobID": task, "State": states.get(task, FORGOTTEN)} for task in waited_for}


def choose_watcher() -> None:
    """Have submitit ask `sacct`, or `squeue` if that does not answer."""
    if not isinstance(SlurmJob.watcher, AccountsWatcher):
        watcher = AccountsWatcher if _has_accounting() else QueueWatcher
        SlurmJob.watcher = watcher(delay_s=_ASKED_EVERY_S)


def queued_tasks(folder: Path) -> list[str]:
    """The names (`17_3`) of this user's tasks that are queued or run, of scripts in a folder; none without SLURM."""
    listed = _squeue("--array", "--states=PENDING,RUNNING,SUSPENDED", f"--user={getpass.getuser()}", "--format=%i|%o")
    tasks = (line.partition("|") for line in (listed or "").splitlines())
    return [name for name, _, script in tasks if Path(script).parent == folder]


def _is_queued(task: str) -> bool:
    """Whether it waits or runs, or is on its way back into the queue, or nobody answers."""
    listed = _squeue(f"--user={getpass.getuser()}", "--array", "--format=%i")
    return listed is None or task in listed.split()


def _squeue(*options: str) -> str | None:
    """What it prints; None where it does not answer."""
    command = ["squeue", "--noheader", *options]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return None


def _has_accounting() -> bool:
    try:
        return subprocess.run(["sacct", "--noheader"], capture_output=True, timeout=60, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False
