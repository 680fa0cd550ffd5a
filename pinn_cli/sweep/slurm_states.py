"""Tasks that are queued, and what became of others where no accounts are kept: submitit would ask `sacct` for ever."""

from __future__ import annotations

import getpass
import subprocess
from pathlib import Path

from submitit import SlurmJob
from submitit.slurm.slurm import SlurmInfoWatcher

# What is made of a task that the cluster has forgotten, as it does some minutes after its end.
FORGOTTEN = "ENDED"


class QueueWatcher(SlurmInfoWatcher):
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


def learn_states_somehow() -> None:
    """Have submitit ask `squeue` if `sacct` does not answer."""
    if not isinstance(SlurmJob.watcher, QueueWatcher) and not _has_accounting():
        SlurmJob.watcher = QueueWatcher(delay_s=60)


def queued_tasks(folder: Path) -> list[str]:
    """The names (`17_3`) of this user's tasks that are queued or run, of scripts in a folder; none without SLURM."""
    listed = ["--noheader", "--array", "--states=PENDING,RUNNING,SUSPENDED", f"--user={getpass.getuser()}"]
    command = ["squeue", *listed, "--format=%i|%o"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError):
        return []
    tasks = (line.partition("|") for line in done.stdout.splitlines())
    return [name for name, _, script in tasks if Path(script).parent == folder]


def _has_accounting() -> bool:
    try:
        return subprocess.run(["sacct", "--noheader"], capture_output=True, timeout=60, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False
