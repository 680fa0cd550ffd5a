"""`hydra/launcher=ray_local` and `ray_cluster`: no lost job takes others along."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import ray
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn
from omegaconf import OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.sweep.launching import PendingJob, Work, WorkLauncher, take_over

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
        """See :meth:`WorkLauncher.run`."""
        _connect(self.init)
        print(f"{len(jobs)} jobs on Ray", file=sys.stderr)
        send = (ray.remote(**self.remote) if self.remote else ray.remote)(_run_job).remote
        work, state = ray.put(self.work), Singleton.get_state()
        sent = [(job, send(work, job.overrides, job.number, state)) for job in jobs]
        return {job.number: _result(job, run) for job, run in sent}


def _run_job(work: Work, overrides: Sequence[str], number: int, state: Any) -> JobReturn:
    take_over(state)
    return work.run(overrides, number)


def _connect(settings: Mapping[str, Any]) -> None:
    """Start a Ray, or join one that runs.

    Raises:
        InputError: There is none at that address.
    """
    settings = dict(settings)
    starts = settings.get("address") is None and "RAY_ADDRESS" not in os.environ
    if starts and not settings.get("object_store_memory"):  # which a Ray that runs refuses
        settings["object_store_memory"] = _OBJECT_STORE
    try:
        if not ray.is_initialized():
            ray.init(**settings)
    except (ConnectionError, RuntimeError, ValueError) as error:
        address = settings.get("address") or os.environ.get("RAY_ADDRESS")
        hint = " ".join(str(error).split())
        raise InputError("hydra.launcher.ray.init.address", address, "that of a Ray cluster", hint) from error


def _result(job: PendingJob, run: Any) -> JobReturn:
    try:
        return ray.get(run)
    except ray.exceptions.RayError as error:
        first = next((line for line in str(error).splitlines() if line.strip()), "")
        return job.lost(f"Ray: {type(error).__name__}: {first.strip()}; log: {job.directory / 'pinn-run.log'}")
