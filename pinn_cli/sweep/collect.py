"""`pinn-run collect=DIRECTORY`, and the end of every sweep: its tables, its summary, its figure, its failures."""

from __future__ import annotations

import shlex
from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.jobs import FAILED, STATUSES, Job, Sweep

if TYPE_CHECKING:
    import pandas

    from pinn_cli.sweep.models import Comparison

SETTINGS_SHOWN, FAILURES_SHOWN = 30, 20


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
        from pinn_cli.sweep.models import compared
        from pinn_cli.sweep.tables import write_tables

        write_tables(sweep, jobs)
        swept = list(dict.fromkeys(setting for job in jobs for setting in sweep.columns(job)))
        summary = _summary(sweep.directory, swept)
        if summary is not None:
            _write_summary(summary, swept, sweep.directory)
        models = compared(sweep, jobs)
        if models is not None:
            _write_models(models, sweep.directory)
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
        lines += [] if self.summary is None else ["", _summary_text(self.summary)]
        if self.models is not None:
            from pinn_cli.sweep.models import models_text

            lines += ["", models_text(self.models)]
        return "\n".join(lines)


def _summary(directory: Path, swept: Sequence[str]) -> pandas.DataFrame | None:
    """Of the sweep's `fitness.csv`."""
    import pandas as pd

    from pinn_cli.sweep.summary import summarise
    from pinn_cli.sweep.tables import FITNESS, REASON, STATUS

    text = dict.fromkeys([*swept, STATUS, REASON], str)
    fitness = pd.read_csv(directory / FITNESS, dtype=text, low_memory=False)
    summary = summarise(fitness, swept) if "fitness_percent" in fitness else None
    return None if summary is None or summary.empty else summary


def _write_summary(summary: pandas.DataFrame, swept: Sequence[str], directory: Path) -> None:
    from pinn_cli.report.figures.style import save
    from pinn_cli.runs.writing import write_table
    from pinn_cli.sweep.figure import sweep_figure
    from pinn_cli.sweep.summary import SUMMARY

    write_table(summary, directory / SUMMARY)
    figure = sweep_figure(summary, [setting for setting in swept if setting in summary])
    if figure is not None:
        save(figure, directory / "figures", "fitness")


def _write_models(models: Comparison, directory: Path) -> None:
    """The table and the figure; where models are not compared, those of an earlier look go."""
    from pinn_cli.report.figures.style import save
    from pinn_cli.runs.writing import write_table
    from pinn_cli.sweep.models import MODELS
    from pinn_cli.sweep.models_figure import models_figure

    figure = models_figure(models)
    if models.table is None or figure is None:
        (directory / MODELS).unlink(missing_ok=True)
        return
    write_table(models.table, directory / MODELS)
    save(figure, directory / "figures", "models")


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
    others += [f"--{name}" for name in ("multirun", "cfg", "info") if getattr(options, name)]
    if others:
        raise InputError("collect", directory, "given alone", f"drop {' '.join(others)}")
    return Path(directory)


def _summary_text(summary: pandas.DataFrame) -> str:
    """The mean of the printed formula over all DOFs, a row per setting and estimator."""
    from pinn_cli.report.terminal.columns import percent

    overall = summary[summary["group"] == "all"]
    settings = [str(name) for name in overall.columns[: list(overall.columns).index("group")]]
    wide = overall.pivot_table(
        index=[*settings, "failed"], columns="quantity", values="fitness_percent_mean", sort=False, dropna=True
    )
    notes = []
    if len(wide) > SETTINGS_SHOWN:
        notes.append(f"the first {SETTINGS_SHOWN} of {len(wide)} settings; all: summary.csv")
        wide = wide.head(SETTINGS_SHOWN)
    text = wide.map(percent).reset_index().to_string(index=False)
    return "\n".join(["mean fitness over all DOFs and seeds, printed formula (%)", text, *notes])


def collect_command(directory: Path) -> str:
    """What a user types to put together what a sweep has so far."""
    return shlex.join(["pinn-run", f"collect={directory}"])
