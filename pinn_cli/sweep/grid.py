"""`hydra/sweeper=basic`: a job for every combination of values, all checked before the first begins."""

from __future__ import annotations

from collections.abc import Sequence

from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from pinn_cli.settings.legal_values import whole_number
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.callback import begin_sweep
from pinn_cli.sweep.composing import compose_job, is_number
from pinn_cli.sweep.directories import combinations


def run_grid(
    hydra_context: HydraContext,
    task_function: TaskFunction,
    config: DictConfig,
    overrides: Sequence[str],
    at_once: int | None,
    most: int,
) -> list[Sequence[JobReturn]]:
    """Run every combination on the launcher that a sweep's configuration names.

    Args:
        hydra_context: Of the sweep, as are the next three.
        task_function: What a job runs.
        config: With its `hydra` node.
        overrides: As typed.
        at_once: How many jobs the launcher gets at a time; None: all.
        most: How many jobs there may be.

    Returns:
        What the jobs returned, by what the launcher got at a time.

    Raises:
        InputError: There are more jobs than that, or a number is none.
        Exception: Whatever Hydra says of overrides that cannot be composed.
    """
    jobs = combinations(overrides, whole_number("hydra.sweeper.max_jobs", most, least=1))
    step = whole_number("hydra.sweeper.max_batch_size", at_once or len(jobs))
    launcher = Plugins.instance().instantiate_launcher(
        hydra_context=hydra_context, task_function=task_function, config=config
    )
    batches = {first: jobs[first : first + step] for first in range(0, len(jobs), step)}
    for job in representatives(jobs):
        compose_job(hydra_context.config_loader, config, job)
    begin_sweep(config)
    returned = []
    for first, batch in batches.items():
        returned.append(launcher.launch(batch, initial_job_idx=first))
        for result in returned[-1]:
            _ = result.return_value  # raises what the job raised
    return returned


def representatives(jobs: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """The first job with each override, the numbers that a setting is given being all alike.

    They stand for all when a sweep is checked, one job after the other before any starts: composing tells that a
    setting or an option is unknown, which the number that a setting is given cannot change.
    """
    chosen: dict[str, Sequence[str]] = {}
    for job in jobs:
        for override in job:
            chosen.setdefault(setting_of(override) if is_number(override) else override, job)
    return [list(job) for job in dict.fromkeys(tuple(job) for job in chosen.values())]
