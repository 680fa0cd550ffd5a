"""`hydra/sweeper=basic` and `hydra/sweeper=search`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import whole_number
from pinn_cli.sweep.composing import MOST_JOBS

# In place of Hydra's, whose settings these are: a file conf/hydra/sweeper/basic.yaml would be checked against that one,
# with a warning. A mapping, since Hydra loads this module in a way that a dataclass is not made for.
BASIC = {
    "_target_": "hydra_plugins.pinn_run.sweepers.BasicSweeper",
    "max_batch_size": None,
    "max_jobs": MOST_JOBS,
    "params": None,
}
ConfigStore.instance().store(group="hydra/sweeper", name="basic", node=BASIC, provider="pinn_run")


class BasicSweeper(Sweeper):
    """Every combination of what the settings may be.

    Args:
        max_batch_size: How many jobs the launcher gets at a time; None: all.
        max_jobs: How many there may be.
        params: What settings may be, besides those on the command line.
    """

    def __init__(
        self,
        max_batch_size: int | None = None,
        max_jobs: int = MOST_JOBS,
        params: Mapping[str, str] | None = None,
    ) -> None:
        self.max_batch_size, self.max_jobs, self.params = max_batch_size, max_jobs, dict(params or {})

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """See :class:`hydra.plugins.sweeper.Sweeper`."""
        self.context = hydra_context, task_function, config

    def sweep(self, arguments: list[str]) -> Any:
        """Run a job for every combination on the launcher; all are composed before the first begins.

        Raises:
            InputError: There are more jobs than that, or a number is none.
            Exception: Whatever Hydra says of overrides that cannot be composed.
        """
        from pinn_cli.sweep.composing import Composer, combinations, representatives
        from pinn_cli.sweep.running import begin_sweep

        context, task_function, config = self.context
        overrides = [*(f"{name}={choices}" for name, choices in self.params.items()), *arguments]
        jobs = combinations(overrides, whole_number("hydra.sweeper.max_jobs", self.max_jobs, least=1))
        step = whole_number("hydra.sweeper.max_batch_size", self.max_batch_size or len(jobs))
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=context, task_function=task_function, config=config
        )
        firsts, composer = range(0, len(jobs), step), Composer(context.config_loader, config)
        for job in representatives(jobs):
            composer.job(job)
        begin_sweep(config)
        returned = []
        for first in firsts:
            returned.append(launcher.launch(jobs[first : first + step], initial_job_idx=first))
            for result in returned[-1]:
                _ = result.return_value  # raises what the job raised
        return returned


class SearchSweeper(Sweeper):
    """Settings that score better than those tried before: see :class:`pinn_cli.sweep.search.Search`."""

    def __init__(self, **settings: Any) -> None:
        self.settings = settings

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """See :class:`hydra.plugins.sweeper.Sweeper`; without Optuna, or with a setting that is none, it is refused."""
        try:
            from pinn_cli.sweep.search import Search
        except ModuleNotFoundError as error:
            if error.name != "optuna":
                raise
            hint = "pip install 'pinn-cli[optuna]'"
            raise InputError("hydra/sweeper", "search", "an installed sweeper", hint) from error
        self.search = Search(hydra_context, task_function, config, **self.settings)

    def sweep(self, arguments: list[str]) -> Any:
        """See :class:`hydra.plugins.sweeper.Sweeper`."""
        return self.search.run(arguments)
