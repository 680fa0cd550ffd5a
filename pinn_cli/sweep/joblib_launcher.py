"""`hydra/launcher=joblib`: a process per job at a time, and one that is killed takes only its own job along.

Each worker has its own share of the cores, and ends with the launcher: nobody else would ever give it another job.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
import uuid
from collections.abc import Sequence
from functools import cache
from typing import Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn
from joblib import Parallel, delayed, effective_n_jobs
from joblib.externals.loky.process_executor import BrokenProcessPool

from pinn_cli.runs.machine import usable_cores
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_whole_number
from pinn_cli.sweep.launching import PendingJob, Work, WorkLauncher, jobs_at_once, take_over, usable_settings

_REASON = "its worker was killed, again when it ran alone: by the system for want of memory, perhaps"
# Seconds from one look for the launcher to the next, and the exit status of a worker that has lost it.
_LOOK_EVERY_S, _STATUS = 1.0, 143

# The sweep that this process, one of joblib's workers, has run jobs of.
_of_sweep = ""
# Its share of the cores, kept open: the system gives it back when the process ends, however it ends.
_claim: socket.socket | None = None


class JoblibLauncher(WorkLauncher):
    """See the module.

    Args:
        work: Of the sweep.
        n_jobs: How many processes; -1: as many as the cores can run at once with the `threads` of a job.
        settings: Of `joblib.Parallel`: `conf/hydra/launcher/joblib.yaml` lists them.
    """

    def __init__(self, work: Work, n_jobs: int = -1, **settings: Any) -> None:
        super().__init__(work)
        if not is_whole_number(n_jobs) or not n_jobs:
            raise InputError("hydra.launcher.n_jobs", n_jobs, "a whole number, -1: as many as the cores can run")
        self.processes = jobs_at_once(work.threads) if n_jobs == -1 else effective_n_jobs(n_jobs)
        self.settings = settings

    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """When a worker is killed, joblib ends all: the others go on, then those that it may have been, each alone."""
        suspects: list[PendingJob] = []
        returns: dict[int, JobReturn] = {}
        while len(returns) + len(suspects) < len(jobs):
            left = [job for job in jobs if job not in suspects]
            began = time.time()
            try:
                returns = self._at_once(left)
            except BrokenProcessPool:
                under_way = [job for job in left if job.under_way_since(began)]
                if not under_way:  # workers do not even start
                    raise
                print(f"a worker was killed: {len(under_way)} jobs are put off, to run alone", file=sys.stderr)
                suspects += under_way
        for job in suspects:
            try:
                returns |= self._at_once([job])
            except BrokenProcessPool:
                returns[job.number] = job.lost(_REASON)
        return returns

    def _at_once(self, jobs: Sequence[PendingJob]) -> dict[int, JobReturn]:
        processes, state, sweep = self.processes, Singleton.get_state(), uuid.uuid4().hex
        calls = (delayed(_run_job)(self.work, job.overrides, job.number, processes, state, sweep) for job in jobs)
        # Hydra's state is the process's: threads would share it.
        with usable_settings(self.settings):
            returned = Parallel(n_jobs=processes, **{**self.settings, "backend": "loky"})(calls)
        return dict(zip((job.number for job in jobs), returned, strict=True))


def _run_job(work: Work, overrides: Sequence[str], number: int, processes: int, state: Any, sweep: str) -> JobReturn:
    """In a worker. It takes over Hydra's state once, and not before each job: Hydra then looks for all its plugins."""
    global _of_sweep  # noqa: PLW0603
    end_with_launcher()
    if _of_sweep != sweep:
        take_over(state)
        _of_sweep = sweep
    pin(processes)
    return work.run(overrides, number)


@cache
def end_with_launcher() -> None:
    """Have this process end within seconds of the one that started it, as by a kill: the job under way can go on."""

    def watch(launcher: int) -> None:
        while os.getppid() == launcher:
            time.sleep(_LOOK_EVERY_S)
        os._exit(_STATUS)

    threading.Thread(target=watch, args=(os.getppid(),), name="launcher", daemon=True).start()


def shares(cores: list[int], workers: int) -> list[list[int]]:
    """Divide cores among workers, neighbouring ones to the same; with more workers than cores some share one."""
    count = len(cores)
    if workers > count:
        return [[cores[worker % count]] for worker in range(workers)]
    return [cores[worker * count // workers : (worker + 1) * count // workers] for worker in range(workers)]


def pin(workers: int) -> None:
    """Keep this process, one of so many workers, to the first share of the cores that none of its siblings has.

    Where the system cannot (it is not Linux), or no share is left, nothing happens. Once in a process is enough.
    """
    global _claim  # noqa: PLW0603
    if _claim is not None or not hasattr(os, "sched_setaffinity"):
        return
    for share, cores in enumerate(shares(usable_cores(), workers)):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0pinn-run cores {os.getppid()} {share}")  # an abstract name, which dies with its owner
        except OSError:
            claim.close()
            continue
        _claim = claim
        os.sched_setaffinity(0, cores)
        return
