"""`pinn-run collect=DIRECTORY`, and the end of every sweep: its tables, its summary, its figure, its failures."""

from __future__ import annotations

import shlex
from argparse import Namespace
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.jobs import FAILED, STATUSES, Job, Sweep

if TYPE_CHECKING:
    import pandas

    from pinn_cli.sweep.models import Comparison

FAILURES_SHOWN = 20


@dataclass(frozen=True, eq=False)
class Collection:
    """What has become of a sweep.

    Attributes:
        jobs: All of it, in its order.
        summary: As `summary.csv` has it; None while no job has a fitness.
        models: Those that the jobs differ in, compared; None where they differ in none.
    """

    jobs: list[Job]
    summary: pandas.DataFrame | None
    models: Comparison | None = None

    @classmethod
    def of(cls, sweep: Sweep, jobs: list[Job]) -> Collection:
        """Write what the sweep's directory holds about all its jobs."""
        if not any(job.ended for job in jobs):
            return cls(jobs, None)
        # Two seconds of imports, not for --help.
        from pinn_cli.sweep.models import compared, write_models
        from pinn_cli.sweep.summary import write_summary
        from pinn_cli.sweep.tables import judged, write_tables

        jobs = [judged(job) for job in jobs]
        write_tables(sweep, jobs)
        swept = list(dict.fromkeys(setting for job in jobs for setting in sweep.columns(job)))
        summary, models = write_summary(sweep.directory, swept), compared(sweep, jobs)
        if models is not None:
            write_models(models, sweep.directory)
        return cls(jobs, summary, models)

    @property
    def exit_status(self) -> int:
        """The worst of the jobs'; 0 if none failed."""
        return max((job.exit_status for job in self.jobs), default=0)

    def text(self) -> str:
        """How many jobs there are of which kind, why some failed, and the mean fitness by setting."""
        counts = Counter(job.status for job in self.jobs)
        counted = [f"{counts[status]} {status}" for status in STATUSES if counts[status]]
        lines = [f"{len(self.jobs)} jobs: {', '.join(counted)}"]
        failed = [job for job in self.jobs if job.status == FAILED]
        lines += [f"  {job.directory.name}: {job.reason}" for job in failed[:FAILURES_SHOWN]]
        lines += [f"  and {len(failed) - FAILURES_SHOWN} more: jobs.csv"] if len(failed) > FAILURES_SHOWN else []
        if self.summary is not None:
            from pinn_cli.sweep.summary import summary_text

            lines += ["", summary_text(self.summary)]
        if self.models is not None:
            from pinn_cli.sweep.models import models_text

            lines += ["", models_text(self.models)]
        return "\n".join(lines)


def asked_for(options: Namespace) -> Path | None:
    """The directory that `pinn-run collect=DIRECTORY` names; None where the command line has none.

    Raises:
        InputError: Something else is asked for along with it.
    """
    named = [override for override in options.overrides if setting_of(override) == "collect"]
    if not named:
        return None
    directory = named[-1].partition("=")[2].strip("'\"")
    others = [override for override in options.overrides if override not in named]
    others += [f"--{name}" for name in ("multirun", "cfg") if getattr(options, name)]
    if others:
        raise InputError("collect", directory, "given alone", f"drop {' '.join(others)}")
    return Path(directory)


def collect_command(directory: Path) -> str:
    """What a user types to put together what a sweep has so far."""
    return shlex.join(["pinn-run", f"collect={directory}"])
