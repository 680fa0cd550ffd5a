"""Fitness against how nonlinear the chain is, with and without model error: a question that the paper leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.paper.study.job import Job, JobResult, solve
from pinn_cli.paper.study.results import Results, all_rows, make_results, read_results
from pinn_cli.record.record import RESPONSE_QUANTITIES
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

# N/m^3 and N; 100 N/m^3 and 1 N are the defaults of the chain and of the force.
KAPPAS = (0.0, 10.0, 100.0, 1000.0, 10000.0)
FORCES = (0.3, 1.0, 3.0, 10.0)
MODEL_ERRORS = ("none", "linear", "perturbed")
# Of force and noise together: one draw of the force may happen to dwell at one amplitude.
SEEDS = 2
KEYS = ["model_error", "kappa", "force_rms", "estimator", "quantity"]


def nonlinearity_jobs() -> list[Job]:
    """Six DOFs, 50 dB, defaults but for kappa, the force's root mean square and the model error."""
    return [
        Job(
            f"{model_error}_kappa{kappa:g}_force{force:g}_seed{seed}",
            (f"system.kappa={kappa}", f"excitation.rms={force}", f"model_error={model_error}",
             "baseline=kalman_smoother"),
            seed, redraws_force=True, columns=(("kappa", kappa), ("force_rms", force)),
        )
        for seed in range(SEEDS)
        for model_error in MODEL_ERRORS
        for kappa in KAPPAS
        for force in FORCES
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class NonlinearityStudy:
    """Fitness over the grid.

    Attributes:
        results: Of the jobs.
        rows: One per job, estimator and quantity, over all DOFs (``nonlinearity_by_seed.csv``).
        summary: Mean over the seeds, one row per `KEYS`, with the mean ``strength``, the worst fitness and the number
            of ``seeds`` that there are (``nonlinearity.csv``).
    """

    results: Results
    rows: pd.DataFrame
    summary: pd.DataFrame

    @property
    def empty(self) -> bool:
        """Whether there is nothing to show."""
        return self.summary.empty


def make_nonlinearity_study(directory: Path, solver: Callable[[Job], JobResult] = solve) -> NonlinearityStudy:
    """Solve what is missing in ``<directory>/runs``, write tables and figure into ``directory``."""
    study = nonlinearity_study(make_results(nonlinearity_jobs(), directory / "runs", solver))
    write_table(study.rows, directory / "nonlinearity_by_seed.csv")
    write_table(study.summary, directory / "nonlinearity.csv")
    write_nonlinearity_figure(study, directory)
    return study


def write_nonlinearity_figure(study: NonlinearityStudy, directory: Path) -> Path | None:
    """Draw the study as ``nonlinearity.png`` and ``.pdf``; the former's path, None where there is nothing to draw."""
    from pinn_cli.paper.study.nonlinearity_figure import nonlinearity_figure
    from pinn_cli.report.figures import style

    return None if study.empty else style.save(nonlinearity_figure(study.summary), directory, "nonlinearity")[0]


def read_nonlinearity_study(directory: Path) -> NonlinearityStudy:
    """What is there and up to date, nothing solved."""
    return nonlinearity_study(read_results(nonlinearity_jobs(), directory / "runs"))


def nonlinearity_study(results: Results) -> NonlinearityStudy:
    """Tables of the results that are there."""
    rows = all_rows(results, "fitness")
    if rows.empty:
        return NonlinearityStudy(results, rows, rows)
    rows = rows[(rows["group"] == "all") & rows["quantity"].isin(RESPONSE_QUANTITIES)].reset_index(drop=True)
    grouped = rows.groupby(KEYS, sort=False)
    summary = grouped[["strength", "fitness_percent", "range_fitness_percent"]].mean()
    summary["worst_fitness_percent"] = grouped["fitness_percent"].min()
    summary.insert(1, "seeds", grouped["seed"].nunique())
    return NonlinearityStudy(results, rows, summary.reset_index())
