"""What all launchers share: which jobs are run, what one is to its worker, and that it was lost; and two of them.

Launchers of other projects raise at the first job that ends without a result, and the others are never collected. Those
here note the loss in the job's directory and go on: the same command runs that job alone again, from its checkpoint.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, cached_property
from multiprocessing import ProcessError
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, run_job, setup_globals
from hydra.types import HydraContext, TaskFunction
from joblib import Parallel, delayed, effective_n_jobs
from omegaconf import DictConfig, open_dict, read_write

from pinn_cli.runs.process import environment, usable_cores
from pinn_cli.runs.resume import asked_to_resume, going_on, is_finished, is_tracked, stored_score
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import is_whole_number, positive_number
from pinn_cli.sweep.composing import Composer
from pinn_cli.sweep.jobs import DEFECT, FINISHED, UNFINISHED, Failure, Job, Sweep, written_since

# A Python that is started imports nothing from the current folder then, where a `numpy.py` may lie.
SAFE_PATH = {"PYTHONSAFEPATH": "1"}
# Workers that are ended leave locks behind, which joblib's own process takes away, and tells of on the terminal.
QUIET_END = {"PYTHONWARNINGS": ",".join([*filter(None, [os.environ.get("PYTHONWARNINGS")]), "ignore:resource_tracker"])}
# Why a job of joblib's has failed.
_REASON = "its worker was killed, again when it ran alone: by the system for want of memory, perhaps"
# Seconds from one look for the launcher to the next, and the exit status of a worker that has lost it.
_LOOK_EVERY_S, _LOST_STATUS = 1.0, 143


@dataclass(frozen=True)
class Work:
    """What a worker, another process perhaps, needs to run any job of a sweep.

    Attributes:
        hydra_context: Of the sweep, as are the next two.
        task_function: What a job runs.
        config: With its `hydra` node.
        state: Hydra's, in the launcher's process.
        key: Tells one sweep from another.
    """

    hydra_context: HydraContext
    task_function: TaskFunction
    config: DictConfig
    state: Any = field(default_factory=Singleton.get_state)
    key: str = field(default_factory=lambda: uuid.uuid4().hex)

    def __reduce__(self) -> tuple[type[Work], tuple[Any, ...]]:
        # Without the configurations that its composer keeps.
        return Work, (self.hydra_context, self.task_function, self.config, self.state, self.key)

    @cached_property
    def _composer(self) -> Composer:
        return Composer(self.hydra_context.config_loader, self.config)

    def composed(self, overrides: Sequence[str], number: int, name: str = "") -> DictConfig:
        """The configuration of a job, with its `hydra` node; `name` is its `hydra.job.id`."""
        config = self._composer.job(overrides)
        with open_dict(config.hydra.job):
            config.hydra.job.id, config.hydra.job.num = name or f"{config.hydra.job.name}_{number}", number
        return config

    def run(self, overrides: Sequence[str], number: int, name: str = "") -> JobReturn:
        """Run a job in this process."""
        config = self.composed(overrides, number, name)
        HydraConfig.instance().set_config(config)
        return run_job(self.task_function, config, "hydra.sweep.dir", "hydra.sweep.subdir", self.hydra_context)


# Of the sweep that this process, a worker, has run jobs of.
_entered: Work | None = None


def in_worker(work: Work) -> Work:
    """The same in a worker, where Hydra is as in the launcher's process from the first job on.

    Not set before each job: Hydra then looks for all its plugins.
    """
    global _entered  # noqa: PLW0603
    if _entered is None or _entered.key != work.key:
        Singleton.set_state(work.state)
        setup_globals()
        _entered = work
    return _entered


def jobs_at_once(threads: int) -> int:
    """How many jobs of that many threads the cores can run at once, at least one."""
    return max(1, len(usable_cores()) // max(1, threads))


@dataclass(frozen=True)
class PendingJob:
    """A job, counted from 0, as the process that launches it sees it, its overrides as Hydra hands them to it."""

    work: Work
    overrides: list[str]
    number: int

    @cached_property
    def config(self) -> DictConfig:
        """Composed as a worker will, with its `hydra` node."""
        return self.work.composed(self.overrides, self.number)

    @cached_property
    def task(self) -> DictConfig:
        """The same without that node, as the job sees it."""
        config = self.config.copy()
        with open_dict(config):
            del config["hydra"]
        return config

    @property
    def directory(self) -> Path:
        """Where it lies, or will."""
        return Path(str(self.config.hydra.sweep.dir)) / str(self.config.hydra.sweep.subdir)

    def goes_on(self) -> bool:
        """Whether it takes up what lies in its directory, as against `resume=never`."""
        HydraConfig.instance().set_config(self.config)
        return asked_to_resume(going_on(self.task), self.directory)

    def finished(self) -> bool:
        """Whether it need not be sent anywhere, since all its results lie there and its tracker has them."""
        there, task = self.directory, self.task
        return self.goes_on() and is_finished(there, task, Path.cwd()) and is_tracked(there, task)

    def returned(self, finished: bool) -> JobReturn:
        """What a sweeper gets for a job that no worker returned anything for: the score in its directory, if any."""
        with read_write(self.config.hydra.runtime):
            self.config.hydra.runtime.output_dir = str(self.directory.absolute())
        result = JobReturn(overrides=self.overrides, cfg=self.task, hydra_cfg=self.config)
        result.status, result.return_value = JobStatus.COMPLETED, stored_score(self.directory) if finished else None
        return result

    def lost(self, reason: str) -> JobReturn:
        """Note that its worker was, unless it had all its results by then or says itself why it failed."""
        finished = self.finished()
        if not finished and Failure.read(self.directory) is None:
            Failure(DEFECT, reason, reason).write(self.directory, self.config.hydra.overrides.task)
        return self.returned(finished)


class WorkLauncher(ABC):
    """How jobs are run; `hydra_plugins` has it as a launcher. A new one is a file here, one there and one in `conf`."""

    def __init__(self, work: Work) -> None:
        self.work = work

    @abstractmethod
    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """Run all jobs, of which there is at least one, and wait for them; what each returned, by its number."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Have all jobs run that are not finished, the first of which has this number.

        Returns:
            What each job returned, in the same order; None for one that was lost.
        """
        jobs = [PendingJob(self.work, list(given), initial_job_idx + n) for n, given in enumerate(job_overrides)]
        # With `strict=true` a job tells its verdict again.
        before = [job for job in jobs if tuple(job.overrides) in self._finished_before and not job.task.get("strict")]
        returns = {job.number: job.returned(finished=True) for job in before if job.finished()}
        unfinished = [job for job in jobs if job.number not in returns]
        if unfinished:
            with environment(SAFE_PATH):
                returns |= self.run(unfinished)
        return [returns[number] for number in sorted(returns)]

    @cached_property
    def _finished_before(self) -> set[tuple[str, ...]]:
        """Overrides of the jobs that had finished when the sweep began: a search launches, and finishes, ever more."""
        sweep = Sweep.of(self.work.config, Path(str(self.work.config.hydra.sweep.dir)))
        return {job.overrides for job in sweep.jobs() if job.status == FINISHED}


@contextmanager
def usable_settings(settings: Mapping[str, Any]) -> Iterator[None]:
    """Refuse settings that the library behind a launcher cannot use; what a job raises does not come here."""
    try:
        yield
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, AssertionError, OverflowError, OSError, ProcessError) as error:
        given = ", ".join(f"{name}: {value}" for name, value in settings.items() if value is not None)
        hint = str(error) or type(error).__name__
        raise InputError("hydra.launcher", f"{{{given}}}", "settings that the launcher can use", hint) from error


class SerialLauncher(WorkLauncher):
    """`hydra/launcher=basic`: one after the other, in this process."""

    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """See :meth:`WorkLauncher.run`."""
        setup_globals()
        return {job.number: self.work.run(job.overrides, job.number) for job in jobs}


class JoblibLauncher(WorkLauncher):
    """`hydra/launcher=joblib`: a process per job at a time, and one that is killed takes only its own job along.

    Each worker has its own share of the cores, and ends with the launcher: nobody else would ever give it another job.

    Args:
        work: Of the sweep.
        n_jobs: How many processes; -1: as many as the cores can run at once with the `threads` of a job.
        settings: Of `joblib.Parallel`: `conf/hydra/launcher/joblib.yaml` lists them.
    """

    def __init__(self, work: Work, n_jobs: int = -1, **settings: Any) -> None:
        super().__init__(work)
        if not is_whole_number(n_jobs) or not n_jobs:
            raise InputError("hydra.launcher.n_jobs", n_jobs, "a whole number, -1: as many as the cores can run")
        if settings.get("timeout") is not None:  # joblib finds out when its workers have begun
            positive_number("hydra.launcher.timeout", settings["timeout"])
        threads = int(work.config.get("threads", 1))
        self.processes = jobs_at_once(threads) if n_jobs == -1 else effective_n_jobs(n_jobs)
        self.settings = settings
        if self.processes == 1 and settings.get("timeout") is not None:  # joblib has no worker then
            print("pinn-run: hydra.launcher.timeout holds for workers beside each other; there is one", file=sys.stderr)
            self.settings = settings | {"timeout": None}

    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """When a worker is killed, joblib ends all: the others go on, then those that it may have been, each alone."""
        suspects: list[PendingJob] = []
        returns: dict[int, JobReturn] = {}
        while len(returns) + len(suspects) < len(jobs):
            others = [job for job in jobs if job not in suspects]
            began = time.time() - 1.0
            try:
                returns = self._at_once(others)
            except BrokenProcessPool:
                begun = [job for job in others if written_since(job.directory, began)]
                under_way = [job for job in begun if Job.read(job.directory, job.overrides).status == UNFINISHED]
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
        calls = (delayed(_run_job)(self.work, job.overrides, job.number, self.processes) for job in jobs)
        # Hydra's state is the process's: threads would share it.
        with usable_settings(self.settings), environment(QUIET_END):
            returned = Parallel(n_jobs=self.processes, **{**self.settings, "backend": "loky"})(calls)
        return dict(zip((job.number for job in jobs), returned, strict=True))


def _run_job(work: Work, overrides: Sequence[str], number: int, processes: int) -> JobReturn:
    end_with_launcher()
    pin(processes)
    return in_worker(work).run(overrides, number)


@cache
def end_with_launcher() -> None:
    """Have this process end within seconds of the one that started it, as by a kill: the job under way can go on."""

    def watch(launcher: int) -> None:
        while os.getppid() == launcher:
            time.sleep(_LOOK_EVERY_S)
        os._exit(_LOST_STATUS)

    threading.Thread(target=watch, args=(os.getppid(),), name="launcher", daemon=True).start()


def shares(cores: list[int], workers: int) -> list[list[int]]:
    """Divide cores among workers, neighbouring ones to the same; with more workers than cores some share one."""
    count = len(cores)
    if workers > count:
        return [[cores[worker % count]] for worker in range(workers)]
    return [cores[worker * count // workers : (worker + 1) * count // workers] for worker in range(workers)]


@cache
def pin(workers: int) -> socket.socket | None:
    """Keep this process, one of so many workers, to the first share of the cores that none of its siblings has.

    Where the system cannot (it is not Linux), or no share is left, nothing happens.

    Returns:
        The claim to the share, kept open: the system gives it back when the process ends, however it ends.
    """
    for share, cores in enumerate(shares(usable_cores(), workers)) if hasattr(os, "sched_setaffinity") else ():
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0pinn-run cores {os.getppid()} {share}")  # an abstract name, which dies with its owner
        except OSError:
            claim.close()
            continue
        os.sched_setaffinity(0, cores)
        return claim
    return None
