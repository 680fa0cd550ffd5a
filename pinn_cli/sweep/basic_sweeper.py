"""`hydra/sweeper=basic`: how its jobs are composed, and how many before the first one begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hydra.types import HydraContext

from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.composing import JobLoader, is_number


class Representatives:
    """What is put before Hydra's sweeper; see the module."""

    def setup(self, *, hydra_context: HydraContext, **others: Any) -> None:
        """Have sweeper and launcher, and with them its workers, compose jobs with a :class:`JobLoader`."""
        loader = JobLoader(hydra_context.config_loader.get_search_path())
        super().setup(hydra_context=replace(hydra_context, config_loader=loader), **others)  # type: ignore[misc]

    def validate_batch_is_legal(self, batch: Sequence[Sequence[str]]) -> None:
        """Compose a job for every override that occurs, rather than every job: one after the other, before any starts.

        Composing takes a tenth of a second and tells that a setting or an option is unknown, which the number that a
        setting is given cannot change.
        """
        super().validate_batch_is_legal(representatives(batch))  # type: ignore[misc]


def composing_few(sweeper: type) -> type:
    """Hydra's sweeper with that.

    It is made from the class that Hydra knows, since Hydra loads the modules of its plugins, and with them the classes,
    anew when it looks for them; and is put here, since Hydra builds it by its name.
    """
    if not issubclass(sweeper, Representatives):
        sweeper = type("BasicSweeper", (Representatives, sweeper), {"__module__": __name__})
        globals()["BasicSweeper"] = sweeper
    return sweeper


def representatives(batch: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """The first job with each override, the numbers that a setting is given being all alike."""
    chosen: dict[str, Sequence[str]] = {}
    for job in batch:
        for override in job:
            chosen.setdefault(setting_of(override) if is_number(override) else override, job)
    return [list(job) for job in dict.fromkeys(tuple(job) for job in chosen.values())]
