"""`hydra/launcher=slurm` and `workstation`: the jobs of a sweep as tasks of submitit.

No job that is lost takes others along; several short ones can share a task, those behind one that is killed are sent
again, those that a launcher sent before it was killed are waited for, and a task that is asked to make room (SIGUSR2)
comes back once the step under way is done and its checkpoint written. Which tasks are queued, `squeue` says.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import submitit
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn
from omegaconf import OmegaConf
from submitit.core.utils import JobPaths

from pinn_cli.runs.interruption import Interruption, warning, watched
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number
from pinn_cli.sweep.failure import UnansweredError
from pinn_cli.sweep.launching import PendingJob, Work, WorkLauncher, jobs_at_once, take_over, usable_settings

# Of the executor itself, rather than of its jobs.
_OF_EXECUTOR = ("submitit_folder", "max_num_timeout")
# Which every executor of submitit has under the same name; all others are called after theirs (slurm_partition).
_SHARED = (
    "name", "timeout_min", "cpus_per_task", "gpus_per_node", "tasks_per_node", "mem_gb", "nodes", "stderr_to_stdout",
)  # fmt: skip
# What is made of a task that the cluster has forgotten, as it does some minutes after its end.
FORGOTTEN = "ENDED"
# States from which no task comes back, once it has been seen in one of them twice: before it is queued again, a task
# that was preempted may be in one. Of a task in one of the second line somebody may have ended it on purpose.
_ENDED = ("BOOT_FAIL", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY", "PREEMPTED", "TIMEOUT")
_ON_PURPOSE = ("CANCELLED", FORGOTTEN)
# Seconds from one look for results to the next, from one `squeue` to the next, and that a slow file system has to show
# the result of a task that has ended.
_LOOK_EVERY_S, _ASK_EVERY_S, _SHOWN_S = 1.0, 10.0, 15.0
# How many times in a row `squeue` may fail, as where its daemon starts anew: a minute, or several if it waits itself.
_UNANSWERED = 6

# A task and its jobs, in the order in which it runs them.
Sent = tuple[Any, list[PendingJob]]


@dataclass(frozen=True)
class Batch:
    """What a task of the scheduler runs; submitit keeps it in a file.

    Attributes:
        work: Of the sweep.
    """

    work: Work

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


class SubmititLauncher(WorkLauncher):
    """See the module.

    Args:
        work: Of the sweep.
        jobs_per_task: How many jobs of the sweep one task of the scheduler runs, one after the other.
        params: `conf/hydra/launcher/` lists them.
    """

    # submitit's name of the scheduler, and what its task is called.
    _EXECUTOR: ClassVar[str]
    _TASK: ClassVar[str]

    def __init__(self, work: Work, jobs_per_task: int | None = None, **params: Any) -> None:
        super().__init__(work)
        self.params: dict[str, Any] = OmegaConf.to_container(OmegaConf.create(params), resolve=True)  # type: ignore[assignment]
        self.jobs_per_task = jobs_per_task

    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """See :meth:`WorkLauncher.run`."""
        returns: dict[int, JobReturn] = {}
        left, sent = jobs, self._sent_before(jobs)
        while left:  # of what is sent, at least one job of each task returns something, or is lost
            under_way = {job.number for _, batch in sent for job in batch}
            batches = self._batches([job for job in left if job.number not in under_way])
            sent += zip(self._submit(batches) if batches else [], batches, strict=True)
            returns |= self._results(sent, self._ended([task for task, _ in sent]))
            left, sent = [job for job in left if job.number not in returns], []
            if left:
                print(f"{len(left)} jobs were behind one that was killed: they are sent again", file=sys.stderr)
        return returns

    def _sent_before(self, jobs: list[PendingJob]) -> list[Sent]:
        """Tasks with jobs of these that a launcher sent before it was killed."""
        return []

    @abstractmethod
    def _ended(self, tasks: list[Any]) -> dict[str, str]:
        """Wait until all tasks have ended; by their names the states of those that have no result."""

    def _batches(self, jobs: list[PendingJob]) -> list[list[PendingJob]]:
        step = whole_number("hydra.launcher.jobs_per_task", self.jobs_per_task or 1, least=1)
        return [jobs[start : start + step] for start in range(0, len(jobs), step)]

    def _submit(self, batches: list[list[PendingJob]]) -> list[Any]:
        state = Singleton.get_state()
        calls = [[(job.overrides, job.number, state) for job in batch] for batch in batches]
        try:
            with usable_settings(self.params):
                tasks = list(self._executor().map_array(Batch(self.work), calls))
        except RuntimeError as error:  # there is no SLURM, or it refuses
            hint = " ".join(str(error).split())
            raise InputError("hydra/launcher", self._EXECUTOR, "one that takes these jobs", hint) from error
        self._announce(sum(map(len, batches)), tasks)
        return tasks

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

    def _results(self, sent: list[Sent], states: dict[str, str]) -> dict[int, JobReturn]:
        """What jobs returned, by their numbers, of tasks that have ended; nothing for those to be sent again."""
        returns: dict[int, JobReturn] = {}
        behind: list[tuple[PendingJob, str]] = []
        cancelled = False
        for task, batch in sent:
            if _has_result(task):
                returns |= dict(zip((job.number for job in batch), task.results()[0], strict=True))
                continue
            state = states[str(task.job_id)]
            cancelled |= state.startswith(_ON_PURPOSE)
            reason = f"{self._TASK} {task.job_id} ended without a result, state {state}; {_details(task)}"
            spared = _never_begun(task, batch)
            behind += [(job, reason) for job in spared]
            returns |= {job.number: job.lost(reason) for job in batch if job not in spared}
        if cancelled:  # one task or the whole array, which its states do not tell: either way nothing is to come back
            returns |= {job.number: job.lost(reason) for job, reason in behind}
        return returns

    def _announce(self, jobs: int, tasks: list[Any]) -> None:
        """How many went where, on the terminal."""


class SlurmLauncher(SubmititLauncher):
    """On a SLURM cluster; see the module."""

    _EXECUTOR, _TASK = "slurm", "SLURM job"
    _failures = 0

    def _sent_before(self, jobs: list[PendingJob]) -> list[Sent]:
        folder, left = self.params["submitit_folder"], {job.number for job in jobs}
        scripts = JobPaths.get_first_id_independent_folder(folder)
        if not jobs[0].goes_on() or not scripts.is_dir():
            return []
        while (queue := self._queue()) is None:
            time.sleep(_ASK_EVERY_S)
        sent: list[Sent] = []
        for name, (state, script) in queue.items():
            if script.parent == scripts and not state.startswith((*_ENDED, *_ON_PURPOSE, "COMPLETING")):
                task: Any = submitit.SlurmJob(folder, name)
                batch = [self.jobs.get(overrides) for overrides in _overrides_of(task)]
                of_sweep = [job for job in batch if job is not None]
                if len(of_sweep) == len(batch) and any(job.number in left for job in of_sweep):
                    sent.append((task, of_sweep))
        for array in dict.fromkeys(_array(task) for task, _ in sent):
            print(f"waiting for SLURM job {array}, sent before; scancel {array} cancels it", file=sys.stderr)
        return sent

    def _ended(self, tasks: list[Any]) -> dict[str, str]:
        left, seen, asked = {str(task.job_id): task for task in tasks}, set[str](), time.monotonic()
        states: dict[str, str] = {}
        while left := {name: task for name, task in left.items() if not _has_result(task)}:
            time.sleep(_LOOK_EVERY_S)
            if time.monotonic() - asked < _ASK_EVERY_S:
                continue
            queue, asked = self._queue(), time.monotonic()
            now = {} if queue is None else {name: queue.get(name, (FORGOTTEN, Path()))[0] for name in left}
            ended = {name for name, state in now.items() if state.startswith((*_ENDED, *_ON_PURPOSE))}
            states |= {name: now[name] for name in ended & seen}
            left, seen = {name: task for name, task in left.items() if name not in states}, ended
        lost = [task for task in tasks if str(task.job_id) in states]
        until = time.monotonic() + _SHOWN_S
        while time.monotonic() < until and not all(map(_has_result, lost)):
            time.sleep(_LOOK_EVERY_S)
        return states

    def _queue(self) -> dict[str, tuple[str, Path]] | None:
        """State and script of this user's tasks by name (`17_3`), ended ones for some minutes; None if nobody answers.

        Raises:
            UnansweredError: Nobody has for some time.
        """
        options = ("--noheader", "--array", "--states=all", f"--user={os.getuid()}", "--format=%i|%T|%o")
        try:
            listed = subprocess.run(["squeue", *options], capture_output=True, text=True, timeout=60, check=True).stdout
        except (OSError, subprocess.SubprocessError) as error:
            self._failures += 1
            if self._failures < _UNANSWERED:
                return None
            said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
            told = (
                f"squeue failed {_UNANSWERED} times in a row ({said[-1]}): what was sent goes on without this command"
            )
            raise UnansweredError(told) from error
        self._failures = 0
        rows = (
            line.split("|", 2) for line in listed.splitlines() if line.count("|") >= 2
        )  # no remarks of the cluster's
        return {name: (state, Path(script)) for name, state, script in rows}

    def _announce(self, jobs: int, tasks: list[Any]) -> None:
        array = _array(tasks[0])
        print(f"{jobs} jobs as SLURM job {array} of {len(tasks)} tasks; scancel {array} cancels it", file=sys.stderr)


class LocalLauncher(SubmititLauncher):
    """Processes of this machine, which submitit starts all at once: one per share of the cores.

    Args:
        jobs_per_task: As above; 0: as many as it takes for no more tasks than the cores can run at once.
    """

    _EXECUTOR, _TASK = "local", "process"

    def _batches(self, jobs: list[PendingJob]) -> list[list[PendingJob]]:
        if self.jobs_per_task:
            return super()._batches(jobs)
        tasks = jobs_at_once(int(self.params.get("cpus_per_task") or 1))
        return [jobs[start::tasks] for start in range(min(tasks, len(jobs)))]

    def _ended(self, tasks: list[Any]) -> dict[str, str]:
        while not all(task.done() for task in tasks):
            time.sleep(_LOOK_EVERY_S)
        return {str(task.job_id): task.state for task in tasks if not _has_result(task)}


def _array(task: Any) -> str:
    return str(task.job_id).partition("_")[0]


def _has_result(task: Any) -> bool:
    file = task.paths.result_pickle
    with suppress(OSError):  # a network's file system looks again where its folder has been changed
        file.parent.chmod(file.parent.stat().st_mode)
    return bool(file.exists())


def _overrides_of(task: Any) -> list[tuple[str, ...]]:
    """The overrides of a task's jobs; none where it has ended."""
    if not _has_result(task):
        with suppress(Exception):  # what cannot be read here, the task cannot read either
            return [tuple(overrides) for overrides, *_ in task.submission().args[0]]
    return []


def _never_begun(task: Any, batch: list[PendingJob]) -> list[PendingJob]:
    """The jobs behind the one that was under way when their task was lost; none if it began none at all."""
    submission = task.paths.submitted_pickle
    if not submission.is_file():
        return []
    sent = submission.stat().st_mtime  # by the clock of the file system that has the jobs' files too
    behind = [job for job in batch if not job.begun_since(sent)]
    return behind if len(behind) < len(batch) else []


def _details(task: Any) -> str:
    """Why submitit did not requeue a task, or the file that says more."""
    file = Path(task.paths.stderr)
    text = file.read_text(errors="replace") if file.is_file() else ""
    stopped = next((line for line in text.splitlines() if "Job not requeued because" in line), "")
    return stopped.partition(": ")[2] or str(file)
