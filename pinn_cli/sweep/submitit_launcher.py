"""`hydra/launcher=slurm` and `workstation`: the jobs of a sweep as tasks of submitit, of which several can share one.

A task that is lost takes its own jobs along, which the same command runs again; those that a launcher sent before it
was killed are waited for; a task that is asked to make room (SIGUSR2) comes back once the step under way is done and
its checkpoint written. Which tasks are queued, `squeue` says.
"""

from __future__ import annotations

import os
import shutil
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
from hydra.core.utils import JobReturn
from omegaconf import OmegaConf
from submitit.core.utils import JobPaths

from pinn_cli.runs.interruption import Interruption, warning, watched
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number
from pinn_cli.sweep.launching import PendingJob, Work, WorkLauncher, in_worker, jobs_at_once, usable_settings
from pinn_cli.sweep.running import tell

# Of the executor itself, rather than of its jobs.
_OF_EXECUTOR = ("submitit_folder", "max_num_timeout")
# Which every executor of submitit has under the same name; all others are called after theirs (slurm_partition).
_SHARED = (
    "name", "timeout_min", "cpus_per_task", "gpus_per_node", "tasks_per_node", "mem_gb", "nodes", "stderr_to_stdout",
)  # fmt: skip
# What is made of a task that the cluster has forgotten, as it does some minutes after its end.
FORGOTTEN = "ENDED"
# States from which no task comes back, once it has been seen in one of them twice: before it is queued again, a task
# that was preempted may be in one.
_ENDED = (
    "BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY", "PREEMPTED", "TIMEOUT",
    FORGOTTEN,
)  # fmt: skip
# Seconds from one look for results to the next, from one `squeue` to the next, and that a slow file system has to show
# the result of a task that has ended.
_LOOK_EVERY_S, _ASK_EVERY_S, _SHOWN_S = 1.0, 10.0, 15.0

# A task and its jobs, in the order in which it runs them; None for one that has not been asked for.
Sent = tuple[Any, Sequence[PendingJob | None]]


@dataclass(frozen=True)
class Batch:
    """What a task of the scheduler runs; submitit keeps it in a file."""

    work: Work

    def __call__(self, batch: Sequence[tuple[list[str], int]]) -> list[JobReturn]:
        """Run the jobs of a task, overrides and number of each, in a worker.

        Raises:
            SystemExit: The task makes room and comes back.
        """
        try:
            # A scheduler sends SIGTERM some time before it kills, and the job may come back or not: by then there is a
            # checkpoint. The task goes on: one that ended here would not be run again.
            with watched((signal.SIGUSR2,)), warning(signal.SIGTERM):
                name = submitit.JobEnvironment().job_id
                return [in_worker(self.work).run(overrides, number, name) for overrides, number in batch]
        except Interruption:  # what was put off to the end of a step: submitit, which had the signal before, requeues
            signal.raise_signal(signal.SIGUSR2)
            raise

    def checkpoint(self, *args: Any, **kwargs: Any) -> Any:
        """What submitit runs when a task comes back: the same again, since each job goes on from its checkpoint."""
        return submitit.helpers.DelayedSubmission(self, *args, **kwargs)


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
        sent = self._sent_before(jobs)
        under_way = {job.number for _, batch in sent for job in batch if job is not None}
        batches = self._batches([job for job in jobs if job.number not in under_way])
        sent += zip(self._submit(batches) if batches else [], batches, strict=True)
        states = self._ended([task for task, _ in sent])
        returns: dict[int, JobReturn] = {}
        for task, batch in sent:
            if _has_result(task):
                pairs = zip(batch, task.results()[0], strict=True)
                returns |= {job.number: returned for job, returned in pairs if job is not None}
                continue
            state = states[str(task.job_id)]
            reason = f"{self._TASK} {task.job_id} ended without a result, state {state}; {_details(task)}"
            returns |= {job.number: job.lost(reason) for job in batch if job is not None}
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
        calls = [[(job.overrides, job.number) for job in batch] for batch in batches]
        try:
            with usable_settings(self.params):
                tasks = list(self._executor().map_array(Batch(self.work), calls))
        except RuntimeError as error:  # there is no SLURM, or it refuses
            hint = " ".join(str(error).split())
            raise InputError("hydra/launcher", self._EXECUTOR, "one that takes these jobs", hint) from error
        if self._EXECUTOR == "slurm":
            array, jobs = _array(tasks[0]), sum(map(len, batches))
            tell(f"{jobs} jobs as SLURM job {array} of {len(tasks)} tasks; scancel {array} cancels it")
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


class SlurmLauncher(SubmititLauncher):
    """On a SLURM cluster; see the module."""

    _EXECUTOR, _TASK = "slurm", "SLURM job"
    _answers = True

    def _sent_before(self, jobs: list[PendingJob]) -> list[Sent]:
        folder, wanted = self.params["submitit_folder"], {tuple(job.overrides): job for job in jobs}
        scripts = JobPaths.get_first_id_independent_folder(folder)
        if not jobs[0].goes_on() or not scripts.is_dir() or shutil.which("squeue") is None:
            return []
        while (queue := self._queue()) is None:
            time.sleep(_ASK_EVERY_S)
        sent: list[Sent] = []
        for name, (state, script) in queue.items():
            if script.parent == scripts and not state.startswith((*_ENDED, "COMPLETING")):
                task: Any = submitit.SlurmJob(folder, name)
                batch = [wanted.get(overrides) for overrides in _overrides_of(task)]
                if any(batch):
                    sent.append((task, batch))
        for array in dict.fromkeys(_array(task) for task, _ in sent):
            tell(f"waiting for SLURM job {array}, sent before; scancel {array} cancels it")
        return sent

    def _ended(self, tasks: list[Any]) -> dict[str, str]:
        waiting, seen, asked = {str(task.job_id): task for task in tasks}, set[str](), time.monotonic()
        states: dict[str, str] = {}
        while waiting := {name: task for name, task in waiting.items() if not _has_result(task)}:
            time.sleep(_LOOK_EVERY_S)
            if time.monotonic() - asked < _ASK_EVERY_S:
                continue
            queue, asked = self._queue(), time.monotonic()
            now = {} if queue is None else {name: queue.get(name, (FORGOTTEN, Path()))[0] for name in waiting}
            ended = {name for name, state in now.items() if state.startswith(_ENDED)}
            states |= {name: now[name] for name in ended & seen}
            waiting, seen = {name: task for name, task in waiting.items() if name not in states}, ended
        lost = [task for task in tasks if str(task.job_id) in states]
        until = time.monotonic() + _SHOWN_S
        while time.monotonic() < until and not all(map(_has_result, lost)):
            time.sleep(_LOOK_EVERY_S)
        return states

    def _queue(self) -> dict[str, tuple[str, Path]] | None:
        """State and script of this user's tasks by name (`17_3`), ended ones for some minutes; None: no answer."""
        options = ("--noheader", "--array", "--states=all", f"--user={os.getuid()}", "--format=%i|%T|%o")
        try:
            listed = subprocess.run(["squeue", *options], capture_output=True, text=True, timeout=60, check=True).stdout
        except (OSError, subprocess.SubprocessError) as error:
            if self._answers:  # as where its daemon starts anew
                said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
                print(f"squeue does not answer, and is asked again ({said[-1]})", file=sys.stderr)
            self._answers = False
            return None
        self._answers = True
        rows = (line.split("|", 2) for line in listed.splitlines())
        return {row[0]: (row[1], Path(row[2])) for row in rows if len(row) == 3}  # no remarks of the cluster's


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


def _details(task: Any) -> str:
    """Why submitit did not requeue a task, or the file that says more."""
    file = Path(task.paths.stderr)
    text = file.read_text(errors="replace") if file.is_file() else ""
    stopped = next((line for line in text.splitlines() if "Job not requeued because" in line), "")
    return stopped.partition(": ")[2] or str(file)
