"""What launchers that send jobs elsewhere need to know of a job: its directory, its results, and that it was lost.

Hydra's plugins for SLURM and Ray raise at the first job that ends without a result, and the others are never collected.
The launchers here, which are these plugins but for that, note the loss in the job's directory and go on.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import DictConfig, OmegaConf, open_dict

from pinn_cli.runs.resume import asked_to_resume, going_on, is_finished, stored_score
from pinn_cli.runs.tracked import is_told
from pinn_cli.sweep.basic_sweeper import composing_few
from pinn_cli.sweep.failure import DEFECT, Failure
from pinn_cli.sweep.jobs import FINISHED, OVERRIDES, UNFINISHED, Job, Sweep

# The plugins' launchers, and ours in their place, which are imported only if they are used.
_IN_PLACE_OF = {
    "hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher": ("joblib_launcher", "JoblibLauncher"),
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher": ("submitit_launcher", "SlurmLauncher"),
    "hydra_plugins.hydra_submitit_launcher.submitit_launcher.LocalLauncher": ("submitit_launcher", "LocalLauncher"),
    "hydra_plugins.hydra_ray_launcher.ray_launcher.RayLauncher": ("ray_launcher", "RayLauncher"),
}
_SWEEPER = "hydra._internal.core_plugins.basic_sweeper.BasicSweeper"


def put_in_place(target: str) -> None:
    """Have Hydra build our launcher or sweeper where a configuration names that of a plugin, if that is installed.

    Hydra builds them only of plugins that it has found, by their name: it is told that the name is of our class.
    """
    known = Plugins.instance().class_name_to_class
    if target in known and target in _IN_PLACE_OF:
        module, name = _IN_PLACE_OF[target]
        known[target] = getattr(importlib.import_module(f"pinn_cli.sweep.{module}"), name)
    elif target == _SWEEPER:
        known[target] = composing_few(known[target])


def keep_plugins() -> None:
    """Have Hydra not look for its plugins again in this process: joblib's workers do before every job, for 40 ms."""
    found = Plugins.instance()
    Plugins.instance = staticmethod(lambda *_: found)  # type: ignore[method-assign]


def to_launch(
    launcher: Any, job_overrides: Sequence[Sequence[str]], first: int
) -> tuple[list[Launched], dict[int, JobReturn]]:
    """The jobs of a sweep that are not finished, and by their numbers what those that are return.

    Args:
        launcher: Set up by Hydra.
        job_overrides: Of each job.
        first: Number of the first.
    """
    sweep = Sweep.of(launcher.config, Path(str(launcher.config.hydra.sweep.dir)))
    found = {job.overrides for job in sweep.jobs() if job.status == FINISHED}
    jobs = [Launched(launcher, list(overrides), first + n) for n, overrides in enumerate(job_overrides)]
    finished = [job for job in jobs if tuple(job.overrides) in found and job.finished()]
    returns = {job.number: job.returned(finished=True) for job in finished}
    return [job for job in jobs if job.number not in returns], returns


@dataclass(frozen=True)
class Launched:
    """A job, as the process that launches it sees it.

    Attributes:
        launcher: Set up by Hydra.
        overrides: As Hydra hands them to the job.
        number: Counted from 0.
    """

    launcher: Any
    overrides: list[str]
    number: int

    @cached_property
    def config(self) -> DictConfig:
        """Composed as a worker will, with its `hydra` node."""
        config = self.launcher.hydra_context.config_loader.load_sweep_config(self.launcher.config, self.overrides)
        with open_dict(config.hydra.job):
            config.hydra.job.id, config.hydra.job.num = f"job_id_for_{self.number}", self.number
        return config

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
        return finished and is_told(self.directory, self.task)

    def begun_since(self, moment: float) -> bool:
        """Whether it was begun, perhaps anew, at that moment or after it, seconds since the epoch."""
        with suppress(OSError):  # not begun at all
            return (self.directory / OVERRIDES).stat().st_mtime >= moment
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
            overrides = self.directory / OVERRIDES
            if not overrides.is_file():  # it had not begun: without this the directory is no job's
                overrides.parent.mkdir(parents=True, exist_ok=True)
                OmegaConf.save(self.config.hydra.overrides.task, overrides)
            Failure(DEFECT, reason, reason).write(self.directory)
        return self.returned(finished)
