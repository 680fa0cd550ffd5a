"""`hydra/launcher=slurm` and `workstation`: the jobs of a sweep as tasks of submitit.

No job that is lost takes others along; finished ones are not sent again, several short ones can share a task, those
behind one that is killed are sent again, those that a launcher sent before it was killed are waited for, and a task
that is asked to make room (SIGUSR2) comes back once the step under way is done and its checkpoint written.
"""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import submitit
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn
from omegaconf import OmegaConf
from submitit.core.utils import JobPaths, UncompletedJobError

from pinn_cli.runs.interruption import Interruption, warning, watched
from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.affinity import jobs_at_once
from pinn_cli.sweep.pending import PendingJob, Work, take_over, unfinished_jobs
from pinn_cli.sweep.slurm_states import FORGOTTEN, choose_watcher, queued_tasks

log = logging.getLogger(__name__)

# Of the executor itself, rather than of its jobs.
_OF_EXECUTOR = ("submitit_folder", "max_num_timeout")
# Which every executor of submitit has under the same name; all others are called after theirs (slurm_partition).
_SHARED = (
    "name",
    "timeout_min",
    "cpus_per_task",
    "gpus_per_node",
    "tasks_per_node",
    "mem_gb",
    "nodes",
    "stderr_to_stdout",
)
# States of a task that somebody ended on purpose, or may have: nobody knows any more.
_ON_PURPOSE = ("CANCELLED", FORGOTTEN)

# A task and its jobs, in the order in which it runs them.
Sent = tuple[Any, list[PendingJob]]


class SubmititLauncher:
    """See the module.

    Args:
        work: Of the sweep.
        jobs_per_task: How many jobs of the sweep one task of the scheduler runs, one after the other.
        params: `conf/hydra/launcher/` lists them.
    """

    _EXECUTOR: ClassVar[str]
    _JOBS_PER_TASK = 1

    def __init__(self, work: Work, jobs_per_task: int | None = None, **params: Any) -> None:
        self.params: dict[str, Any] = OmegaConf.to_container(OmegaConf.create(params), resolve=True)  # type: ignore[assignment]
        self.work = work
        self.jobs_per_task = self._JOBS_PER_TASK if jobs_per_task is None else jobs_per_task

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Have all jobs that are not finished run and wait for them.

        Args:
            job_overrides: Of each job.
            initial_job_idx: Number of the first.

        Returns:
            What each job returned, in the same order; None for one that was lost.
        """
        left, returns = unfinished_jobs(self.work, job_overrides, initial_job_idx)
        sent = self._sent_before(left, {tuple(job): initial_job_idx + n for n, job in enumerate(job_overrides)})
        while left:  # of what is sent, at least one job of each task returns something, or is lost
            under_way = {job.number for _, batch in sent for job in batch}
            batches = self._batches([job for job in left if job.number not in under_way])
            returns |= _results([*sent, *zip(self._submit(batches) if batches else [], batches, strict=True)])
            left, sent = [job for job in left if job.number not in returns], []
            if left:
                print(f"{len(left)} jobs were behind one that was killed: they are sent again", file=sys.stderr)
        return [returns[number] for number in sorted(returns)]

    def __call__(self, batch: Sequence[tuple[Any, ...]]) -> list[JobReturn]:
        """Run the jobs of a task, in a worker.

        Args:
            batch: Overrides and number of each job, and the state of Hydra where it was launched.

        Raises:
            SystemExit: The task makes room and comes back.
        """
        try:
            # A scheduler sends SIGTERM some time before it kills, and the job may come back or not: by then there is a
            # checkpoint. The task goes on: one that ended here would not be run again.
            with watched((signal.SIGUSR2,)), warning(signal.SIGTERM):
                return [self._run(*job) for job in batch]
        except Interruption:  # what was put off to the end of a step: submitit, which had the signal before, requeues
            signal.raise_signal(signal.SIGUSR2)
            raise

    def checkpoint(self, *args: Any, **kwargs: Any) -> Any:
        """What submitit runs when a task comes back: the same again, since each job goes on from its checkpoint."""
        return submitit.helpers.DelayedSubmission(self, *args, **kwargs)

    def _run(self, overrides: list[str], number: int, state: Any) -> JobReturn:
        take_over(state)
        return self.work.run(overrides, number, submitit.JobEnvironment().job_id)

    def _sent_before(self, left: list[PendingJob], numbers: dict[tuple[str, ...], int]) -> list[Sent]:
        """Tasks with jobs of those left that a launcher sent before it was killed; the jobs' numbers by overrides."""
        return []

    def _batches(self, jobs: list[PendingJob]) -> list[list[PendingJob]]:
        return [jobs[start : start + self.jobs_per_task] for start in range(0, len(jobs), self.jobs_per_task)]

    def _submit(self, batches: list[list[PendingJob]]) -> list[Any]:
        try:
            executor = self._executor()
            tasks = executor.map_array(self, self._calls(batches))
        except RuntimeError as error:  # there is no SLURM, or it refuses
            hint = " ".join(str(error).split())
            raise InputError("hydra/launcher", self._EXECUTOR, "one that takes these jobs", hint) from error
        self._announce(sum(map(len, batches)), tasks)
        return list(tasks)

    def _executor(self) -> Any:
        init = {"folder": self.params["submitit_folder"]}
        if "max_num_timeout" in self.params:
            init[f"{self._EXECUTOR}_max_num_timeout"] = self.params["max_num_timeout"]
        executor = submitit.AutoExecutor(cluster=self._EXECUTOR, **init)
        given = {name: value for name, value in self.params.items() if name not in _OF_EXECUTOR}
        if given.get("additional_parameters"):  # submitit knows no option of sbatch that is not to be given
            more = given["additional_parameters"].items()
            given["additional_parameters"] = {name: value for name, value in more if value not in (None, False)}
        executor.update_parameters(**{n if n in _SHARED else f"{self._EXECUTOR}_{n}": v for n, v in given.items()})
        return executor

    def _calls(self, batches: list[list[PendingJob]]) -> list[list[tuple[Any, ...]]]:
        state = Singleton.get_state()
        return [[(job.overrides, job.number, state) for job in batch] for batch in batches]

    def _announce(self, jobs: int, tasks: list[Any]) -> None:
        """How many went where, on the terminal."""


class SlurmLauncher(SubmititLauncher):
    """On a SLURM cluster; see the module."""

    _EXECUTOR = "slurm"

    def _sent_before(self, left: list[PendingJob], numbers: dict[tuple[str, ...], int]) -> list[Sent]:
        if not left or not left[0].goes_on():
            return []
        choose_watcher()
        folder, wanted = self.params["submitit_folder"], {job.number for job in left}
        sent: list[Sent] = []
        for name in queued_tasks(JobPaths.get_first_id_independent_folder(folder)):
            task: Any = submitit.SlurmJob(folder, name)
            jobs = _jobs_of(task)
            if all(job in numbers for job in jobs) and any(numbers[job] in wanted for job in jobs):
                sent.append((task, [PendingJob(self.work, list(job), numbers[job]) for job in jobs]))
        for array in dict.fromkeys(_array(task) for task, _ in sent):
            print(f"waiting for SLURM job {array}, sent before; scancel {array} cancels it", file=sys.stderr)
        return sent

    def _executor(self) -> Any:
        choose_watcher()
        return super()._executor()

    def _announce(self, jobs: int, tasks: list[Any]) -> None:
        array = _array(tasks[0])
        print(f"{jobs} jobs as SLURM job {array} of {len(tasks)} tasks; scancel {array} cancels it", file=sys.stderr)


def _array(task: Any) -> str:
    return str(task.job_id).partition("_")[0]


def _jobs_of(task: Any) -> list[tuple[str, ...]]:
    """The overrides of a task's jobs; none where it has ended."""
    if not task.paths.result_pickle.exists():
        with suppress(Exception):  # what cannot be read here, the task cannot read either
            return [tuple(overrides) for overrides, *_ in task.submission().args[0]]
    return []


class LocalLauncher(SubmititLauncher):
    """Processes of this machine, which submitit starts all at once: one per share of the cores.

    Args:
        jobs_per_task: As above; 0: as many as it takes for no more tasks than the cores can run at once.
    """

    _EXECUTOR, _JOBS_PER_TASK = "local", 0

    def _batches(self, jobs: list[PendingJob]) -> list[list[PendingJob]]:
        if self.jobs_per_task > 0:
            return super()._batches(jobs)
        tasks = jobs_at_once(int(self.params.get("cpus_per_task") or 1))
        return [jobs[start::tasks] for start in range(min(tasks, len(jobs)))]


def _results(sent: list[Sent]) -> dict[int, JobReturn]:
    """What jobs returned, by their numbers, once their tasks have ended; nothing for those to be sent again."""
    returns: dict[int, JobReturn] = {}
    behind: list[tuple[PendingJob, str]] = []
    cancelled = False
    for place, (task, batch) in enumerate(sent):
        returned, reason = _outcome(task, sent[place + 1 :])
        if not reason:
            returns.update(zip((job.number for job in batch), returned, strict=True))
            continue
        cancelled |= task.state.startswith(_ON_PURPOSE)
        spared = _never_begun(task, batch)
        behind += [(job, reason) for job in spared]
        returns |= {job.number: job.lost(reason) for job in batch if job not in spared}
    if cancelled:  # one task or the whole array, which its states do not tell: either way nothing is to come back
        returns |= {job.number: job.lost(reason) for job, reason in behind}
    return returns


def _outcome(task: Any, others: list[Sent]) -> tuple[list[JobReturn], str]:
    """What a task's jobs returned, once it has ended, or why it was lost; `others` are to be asked after it."""
    task.wait()
    ended = [] if task.paths.result_pickle.exists() else [other for other, _ in others if other.done()]
    try:
        return list(task.results()[0]), ""
    except UncompletedJobError as error:
        # submitit gives a slow file system 15 s to show the result of a task that has ended: once, not for each of the
        # hundreds of an array that was cancelled.
        for other in ended:
            other._results_timeout_s = 0
        return [], _reason(task, error)


def _never_begun(task: Any, batch: list[PendingJob]) -> list[PendingJob]:
    """The jobs behind the one that was under way when their task was lost; none if it began none at all."""
    submission = task.paths.submitted_pickle
    if not submission.is_file():
        return []
    sent = submission.stat().st_mtime  # by the clock of the file system that has the jobs' files too
    behind = [job for job in batch if not job.begun_since(sent)]
    return behind if len(behind) < len(batch) else []


def _reason(task: Any, error: Exception) -> str:
    log.info("%s", error)
    where = "SLURM job" if type(task).__name__ == "SlurmJob" else "process"
    ended = f"{where} {task.job_id} ended without a result, state {task.state}"
    stopped = next((line for line in str(error).splitlines() if "Job not requeued because" in line), "")
    return f"{ended}; {stopped.partition(': ')[2] or Path(task.paths.stderr)}"
