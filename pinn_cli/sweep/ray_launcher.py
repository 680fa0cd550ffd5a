"""`hydra/launcher=ray_local` and `ray_cluster`: no lost job takes others along."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import ray
from hydra.core.utils import JobReturn
from omegaconf import OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.launching import PendingJob, Work, WorkLauncher, in_worker
from pinn_cli.sweep.running import tell

# The least that Ray takes, bytes: what jobs hand over is small, their results lie in files.
_OBJECT_STORE = 75 * 2**20


class RayLauncher(WorkLauncher):
    """See the module.

    Args:
        work: Of the sweep.
        ray: Its `init` is of `ray.init`, its `remote` of `ray.remote`: `conf/hydra/launcher/` lists the settings.
    """

    def __init__(self, work: Work, ray: Any) -> None:
        super().__init__(work)
        settings: Any = OmegaConf.to_container(ray, resolve=True)
        self.init, self.remote = settings.get("init") or {}, settings.get("remote") or {}

    def run(self, jobs: list[PendingJob]) -> dict[int, JobReturn]:
        """See :meth:`WorkLauncher.run`; an address where there is no Ray is refused."""
        address = self.init.get("address") or os.environ.get("RAY_ADDRESS")
        if address is None and not self.init.get("object_store_memory"):  # which a Ray that runs refuses
            self.init["object_store_memory"] = _OBJECT_STORE
        try:
            if not ray.is_initialized():
                ray.init(**self.init)
        except (ConnectionError, RuntimeError, ValueError) as error:
            hint = " ".join(str(error).split())
            raise InputError("hydra.launcher.ray.init.address", address, "that of a Ray cluster", hint) from error
        tell(f"{len(jobs)} jobs on Ray")
        send, work = (ray.remote(**self.remote) if self.remote else ray.remote)(_run_job).remote, ray.put(self.work)
        sent = [(job, send(work, job.overrides, job.number)) for job in jobs]
        return {job.number: _result(job, run) for job, run in sent}


def _run_job(work: Work, overrides: Sequence[str], number: int) -> JobReturn:
    return in_worker(work).run(overrides, number)


def _result(job: PendingJob, run: Any) -> JobReturn:
    try:
        return ray.get(run)
    except ray.exceptions.RayError as error:
        first = next((line for line in str(error).splitlines() if line.strip()), "")
        return job.lost(f"Ray: {type(error).__name__}: {first.strip()}; log: {job.directory / 'pinn-run.log'}")
