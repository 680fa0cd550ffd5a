"""`hydra/launcher=joblib`: a process per job at a time, and one that is killed takes only its own job along."""

from __future__ import annotations

import sys
import time
import uuid
from collections.abc import Sequence
from typing import Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn
from joblib import Parallel, delayed, effective_n_jobs
from joblib.externals.loky.process_executor import BrokenProcessPool

from pinn_cli.sweep.affinity import jobs_at_once, pin
from pinn_cli.sweep.orphans import end_with_launcher
from pinn_cli.sweep.pending import PendingJob, Work, take_over

_REASON = "its worker was killed, again when it ran alone: by the system for want of memory, perhaps"

# The sweep that this process, one of joblib's workers, has run jobs of.
_of_sweep = ""


class JoblibLauncher:
    """See the module.

    Args:
        work: Of the sweep.
        n_jobs: How many processes; -1: as many as the cores can run at once with the `threads` of a job.
        settings: Of `joblib.Parallel`: `conf/hydra/launcher/joblib.yaml` lists them.
    """

    def __init__(self, work: Work, n_jobs: int = -1, **settings: Any) -> None:
        threads = int(work.config.get("threads", 1))
        self.processes = jobs_at_once(threads) if n_jobs == -1 else effective_n_jobs(n_jobs)
        self.work, self.settings = work, settings

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run all jobs. When a worker is killed, joblib ends all: the others go on, then those that it may have been.

        Args:
            job_overrides: Of each job.
            initial_job_idx: Number of the first.

        Returns:
            What each job returned, in the same order; None for one that was lost.
        """
        jobs = [
            PendingJob(self.work, list(overrides), initial_job_idx + n) for n, overrides in enumerate(job_overrides)
        ]
        suspects: list[PendingJob] = []
        returns: dict[int, JobReturn] = {}
        while len(returns) + len(suspects) < len(jobs):
            left = [job for job in jobs if job not in suspects]
            began = time.time()
            try:
                returns = self._run(left)
            except BrokenProcessPool:
                under_way = [job for job in left if job.under_way_since(began)]
                if not under_way:  # workers do not even start
                    raise
                print(f"a worker was killed: {len(under_way)} jobs are put off, to run alone", file=sys.stderr)
                suspects += under_way
        for job in suspects:
            returns |= self._run_alone(job)
        return [returns[number] for number in sorted(returns)]

    def _run_alone(self, job: PendingJob) -> dict[int, JobReturn]:
        try:
            return self._run([job])
        except BrokenProcessPool:
            return {job.number: job.lost(_REASON)}

    def _run(self, jobs: Sequence[PendingJob]) -> dict[int, JobReturn]:
        processes, state, sweep = self.processes, Singleton.get_state(), uuid.uuid4().hex
        calls = (delayed(_run_job)(self.work, job.overrides, job.number, processes, state, sweep) for job in jobs)
        # Hydra's state is the process's: threads would share it.
        returned = Parallel(n_jobs=processes, **{**self.settings, "backend": "loky"})(calls) if jobs else []
        return dict(zip((job.number for job in jobs), returned, strict=True))


def _run_job(work: Work, overrides: Sequence[str], number: int, processes: int, state: Any, sweep: str) -> JobReturn:
    """In a worker. It takes over Hydra's state once, and not before each job: Hydra then looks for all its plugins."""
    global _of_sweep  # noqa: PLW0603
    end_with_launcher()
    if _of_sweep != sweep:
        take_over(state)
        _of_sweep = sweep
    pin(processes)
    return work.run(overrides, number, f"{work.config.hydra.job.name}_{number}")
