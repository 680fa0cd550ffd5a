"""What all launchers share: which jobs are run, what one is to its worker, and that it was lost.

Launchers of other projects raise at the first job that ends without a result, and the others are never collected. Those
here note the loss in the job's directory and go on: the same command runs that job alone again, from its checkpoint.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from multiprocessing import ProcessError
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, run_job, setup_globals
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict

from pinn_cli.runs.lock import FILE as LOCK
from pinn_cli.runs.machine import usable_cores
from pinn_cli.runs.process import environment
from pinn_cli.runs.resume import asked_to_resume, going_on, is_finished, is_tracked, stored_score
from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.composing import compose_job
from pinn_cli.sweep.failure import DEFECT, Failure
from pinn_cli.sweep.failure import FILE as FAILURE
from pinn_cli.sweep.jobs import FINISHED, OVERRIDES, UNFINISHED, Job, Sweep, note_failure

SAFE_PATH = "PYTHONSAFEPATH"


@dataclass(frozen=True)
class Work:
    """What a worker, another process perhaps, needs to run any job of a sweep.

    Attributes:
        hydra_context: Of the sweep, as are the next two.
        task_function: What a job runs.
        config: With its `hydra` node.
    """

    hydra_context: HydraContext
    task_function: TaskFunction
    config: DictConfig

    @property
    def threads(self) -> int:
        """Of a job, at least one."""
        return max(1, int(self.config.get("threads", 1)))

    def composed(self, overrides: Sequence[str], number: int, name: str = "") -> DictConfig:
        """The configuration of a job, with its `hydra` node; `name` is its `hydra.job.id`."""
        config = compose_job(self.hydra_context.config_loader, self.config, overrides)
        with open_dict(config.hydra.job):
            config.hydra.job.id, config.hydra.job.num = name or f"{config.hydra.job.name}_{number}", number
        return config

    def run(self, overrides: Sequence[str], number: int, name: str = "") -> JobReturn:
        """Run a job in this process."""
        config = self.composed(overrides, number, name)
        HydraConfig.instance().set_config(config)
        return run_job(
            hydra_context=self.hydra_context,
            config=config,
            task_function=self.task_function,
            job_dir_key="hydra.sweep.dir",
            job_subdir_key="hydra.sweep.subdir",
        )


def take_over(state: Any) -> None:
    """Have Hydra be in this process, a worker's, as it was in the launcher's, whose `Singleton.get_state` this is."""
    Singleton.set_state(state)
    setup_globals()


def jobs_at_once(threads: int) -> int:
    """How many jobs of that many threads the cores can run at once, at least one."""
    return max(1, len(usable_cores()) // max(1, threads))


@dataclass(frozen=True)
class PendingJob:
    """A job, as the process that launches it sees it.

    Attributes:
        work: Of its sweep.
        overrides: As Hydra hands them to the job.
        number: Counted from 0.
    """

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
        finished = self.goes_on() and is_finished(self.directory, self.task, Path.cwd())
        return finished and is_tracked(self.directory, self.task)

    def begun_since(self, moment: float) -> bool:
        """Whether it was begun, perhaps anew, at that moment or after it, seconds since the epoch."""
        for sign in (OVERRIDES, LOCK, FAILURE):
            with suppress(OSError):  # there is none
                if (self.directory / sign).stat().st_mtime >= moment:
                    return True
        return False

    def under_way_since(self, moment: float) -> bool:
        """Whether it was begun after that moment, seconds since the epoch, and has not ended."""
        return self.begun_since(moment - 1.0) and Job.read(self.directory, self.overrides).status == UNFINISHED

    def returned(self, finished: bool) -> JobReturn:
        """What a sweeper gets for a job that no worker returned anything for: the score in its directory, if any."""
        result = JobReturn(overrides=self.overrides, cfg=self.task, hydra_cfg=self.config)
        result.status, result.return_value = JobStatus.COMPLETED, stored_score(self.directory) if finished else None
        return result

    def lost(self, reason: str) -> JobReturn:
        """Note that its worker was, unless it had all its results by then or says itself why it failed."""
        finished = self.finished()
        if not finished and Failure.read(self.directory) is None:
            note_failure(self.directory, self.config.hydra.overrides.task, Failure(DEFECT, reason, reason))
        return self.returned(finished)


class WorkLauncher(ABC):
    """How jobs are run; what `hydra_plugins` has as a launcher. A new one is a file here, one there and one in `conf`.

    Args:
        work: Of the sweep.

    Attributes:
        jobs: What it was asked to run, by their overrides, finished ones among them.
    """

    def __init__(self, work: Work) -> None:
        self.work = work
        self.jobs: dict[tuple[str, ...], PendingJob] = {}

    @abstractmethod
    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """Run all jobs, of which there is at least one, and wait for them; what each returned, by its number."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Have all jobs run that are not finished.

        Args:
            job_overrides: Of each job.
            initial_job_idx: Number of the first.

        Returns:
            What each job returned, in the same order; None for one that was lost.
        """
        jobs = [PendingJob(self.work, list(given), initial_job_idx + n) for n, given in enumerate(job_overrides)]
        self.jobs = {tuple(job.overrides): job for job in jobs}
        returns = {job.number: job.returned(finished=True) for job in self._finished(jobs)}
        left = [job for job in jobs if job.number not in returns]
        if left:
            # A Python that is started imports nothing from the current folder then, where a `numpy.py` may lie.
            with environment({SAFE_PATH: "1"}):
                returns |= self.run(left)
        return [returns[number] for number in sorted(returns)]

    def _finished(self, jobs: Sequence[PendingJob]) -> list[PendingJob]:
        """Those that need not be run; with `strict=true` a job tells its verdict again."""
        candidates = (job for job in jobs if tuple(job.overrides) in self._finished_before)
        return [job for job in candidates if job.task.get("strict") is not True and job.finished()]

    @cached_property
    def _finished_before(self) -> set[tuple[str, ...]]:
        """Overrides of the jobs that had finished when the sweep began: a search launches, and finishes, ever more."""
        sweep = Sweep.of(self.work.config, Path(str(self.work.config.hydra.sweep.dir)))
        return {job.overrides for job in sweep.jobs() if job.status == FINISHED}


@contextmanager
def usable_settings(settings: Mapping[str, Any]) -> Iterator[None]:
    """Tell of settings that the library behind a launcher cannot use; what a job raises does not come here.

    Raises:
        InputError: It cannot.
    """
    try:
        yield
    except InputError:
        raise
    except (TypeError, ValueError, AttributeError, AssertionError, OverflowError, OSError, ProcessError) as error:
        given = ", ".join(f"{name}: {value}" for name, value in settings.items() if value is not None)
        raise InputError(
            "hydra.launcher", f"{{{given}}}", "settings that the launcher can use", str(error) or type(error).__name__
        ) from error


class SerialLauncher(WorkLauncher):
    """`hydra/launcher=basic`: one after the other, in this process."""

    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """See :meth:`WorkLauncher.run`."""
        setup_globals()
        return {job.number: self.work.run(job.overrides, job.number) for job in jobs}
