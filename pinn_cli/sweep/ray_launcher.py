"""`hydra/launcher=ray`: Hydra's plugin, but no job that is lost takes others along, and finished ones are not sent."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn
from hydra_plugins.hydra_ray_launcher import ray_launcher as plugin

from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.launched import Launched, to_launch

# The least that Ray takes, bytes: what jobs hand over is small, their results lie in files.
_OBJECT_STORE = 75 * 2**20


class RayLauncher(plugin.RayLauncher):
    """See the module."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Have all jobs that are not finished run and wait for them.

        Args:
            job_overrides: Of each job.
            initial_job_idx: Number of the first.

        Returns:
            What each job returned, in the same order; None for one that was lost.
        """
        jobs, returns = to_launch(self, job_overrides, initial_job_idx)
        if jobs:
            self._connect()
            print(f"{len(jobs)} jobs on Ray", file=sys.stderr)
        for job, run in [(job, self._send(job)) for job in jobs]:
            returns[job.number] = _result(job, run)
        return [returns[number] for number in sorted(returns)]

    def _connect(self) -> None:
        from hydra_plugins.hydra_ray_launcher._launcher_util import start_ray

        settings = _init(self.ray_cfg.init)
        try:
            start_ray(settings)
        except (ConnectionError, RuntimeError, ValueError) as error:
            address = settings.get("address") or os.environ.get("RAY_ADDRESS")
            hint = " ".join(str(error).split())
            raise InputError("hydra.launcher.ray.init.address", address, "that of a Ray cluster", hint) from error

    def _send(self, job: Launched) -> Any:
        from hydra_plugins.hydra_ray_launcher._launcher_util import launch_job_on_ray

        state = Singleton.get_state()
        return launch_job_on_ray(self.hydra_context, self.ray_cfg.remote, job.config, self.task_function, state)


def _init(settings: Any) -> Any:
    """With what a Ray that is started here needs, and an existing one refuses."""
    settings = settings.copy()
    if settings.get("address") is None and "RAY_ADDRESS" not in os.environ and not settings.get("object_store_memory"):
        settings.object_store_memory = _OBJECT_STORE
    return settings


def _result(job: Launched, run: Any) -> JobReturn:
    import ray

    try:
        return ray.get(run)
    except ray.exceptions.RayError as error:
        first = next((line for line in str(error).splitlines() if line.strip()), "")
        return job.lost(f"Ray: {type(error).__name__}: {first.strip()}; log: {Path(job.directory) / 'pinn-run.log'}")
