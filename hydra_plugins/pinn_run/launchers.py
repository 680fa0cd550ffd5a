"""The launchers: one process, and those that `conf/hydra/launcher/` has: joblib, SLURM, this machine, Ray."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any, ClassVar

from hydra.core.config_store import ConfigStore
from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from pinn_cli.settings.errors import InputError

# In place of Hydra's, which composes every job from all its files.
ConfigStore.instance().store(
    group="hydra/launcher",
    name="basic",
    node={"_target_": "hydra_plugins.pinn_run.launchers.SerialLauncher"},
    provider="pinn_run",
)


class DeferredLauncher(Launcher):
    """The launcher of the same name in a module of `pinn_cli.sweep`, imported when a sweep begins.

    Attributes:
        module: Of `pinn_cli.sweep`.
        extra: Of this package, which brings what that module imports.
    """

    module: ClassVar[str]
    extra: ClassVar[str]

    def __init__(self, **settings: Any) -> None:
        self.settings = settings

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """See :class:`hydra.plugins.launcher.Launcher`; one whose packages are not installed is refused."""
        try:
            launcher = getattr(importlib.import_module(f"pinn_cli.sweep.{self.module}"), type(self).__name__)
        except ModuleNotFoundError as error:
            if str(error.name).startswith("pinn_cli"):
                raise
            chosen = config.hydra.runtime.choices["hydra/launcher"]
            hint = f"pip install 'pinn-cli[{self.extra}]'"
            raise InputError("hydra/launcher", chosen, "an installed launcher", hint) from error
        from pinn_cli.sweep.launching import Work

        self.launcher = launcher(Work(hydra_context, task_function, config), **self.settings)

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """See :class:`hydra.plugins.launcher.Launcher`."""
        returned: Sequence[JobReturn] = self.launcher.launch(job_overrides, initial_job_idx)
        return returned


class SerialLauncher(DeferredLauncher):
    """`hydra/launcher=basic`."""

    module, extra = "launching", ""

    def __init__(self) -> None:
        super().__init__()


class JoblibLauncher(DeferredLauncher):
    """`hydra/launcher=joblib`."""

    module, extra = "launching", ""


class SlurmLauncher(DeferredLauncher):
    """`hydra/launcher=slurm`."""

    module, extra = "submitit_launcher", "slurm"


class LocalLauncher(DeferredLauncher):
    """`hydra/launcher=workstation`."""

    module, extra = "submitit_launcher", "slurm"


class RayLauncher(DeferredLauncher):
    """`hydra/launcher=ray_local` and `hydra/launcher=ray_cluster`."""

    module, extra = "ray_launcher", "ray"
