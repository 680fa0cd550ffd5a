"""`hydra/sweeper=basic`: how many jobs are composed before the first one begins."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pinn_cli.quoting import setting_of

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


class Representatives:
    """What is put before Hydra's sweeper; see the module."""

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
            value = override.partition("=")[2]
            chosen.setdefault(setting_of(override) if _NUMBER.fullmatch(value) else override, job)
    return [list(job) for job in dict.fromkeys(tuple(job) for job in chosen.values())]
