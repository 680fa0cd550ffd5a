"""One estimate of many: what is solved, and what is kept of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.paper.study.posed import Posed, posed
from pinn_cli.report.beside import Beside, stacked
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.runs.stages import Stages
from pinn_cli.settings.errors import DivergenceError

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Job:
    """A problem that is solved by the network and by a baseline.

    Attributes:
        name: Of its file.
        overrides: As `pinn-run` takes them, without the seed.
        seed: Of the noise, and of the force where `redraws_force`.
        redraws_force: Whether the phases of the force are drawn anew with each seed.
        columns: Name and value of what says in a table which job a row is of, beside the labels that all have.
    """

    name: str
    overrides: tuple[str, ...]
    seed: int
    redraws_force: bool = False
    columns: tuple[tuple[str, float], ...] = ()

    @property
    def command(self) -> tuple[str, ...]:
        """All overrides. Seeds of single channels, such as the authors', would overrule the job's own."""
        force = (f"excitation.seed={self.seed}",) if self.redraws_force else ()
        return (*self.overrides, "noise.seeds=null", f"seed={self.seed}", *force)

    def labels(self, strength: float) -> dict[str, float]:
        """The job's own columns, with `JobResult.strength` where it has any."""
        return {**dict(self.columns), "strength": strength} if self.columns else {}


@dataclass(frozen=True, eq=False)
class JobResult:
    """What a job found.

    Attributes:
        fitness: As ``fitness.csv`` of a run with a baseline, groups of several DOFs only.
        parameters: As its ``parameters.csv``.
        seconds: By stage: ``record`` (configuration and simulation), ``estimate``, ``baseline``, ``total``.
        strength: The largest mean square nonlinear stiffness of a connection over its linear one, kappa rms(e)^2 / k
            for an elongation e; NaN for chains without kappa.
        failure: Why there is nothing of the network's, in one line; empty where there is.
    """

    fitness: pd.DataFrame
    parameters: pd.DataFrame
    seconds: Mapping[str, float]
    strength: float
    failure: str = ""


def solve(job: Job) -> JobResult:
    """Pose a job's problem, solve it in this process and score what was found.

    A training that diverges is a result too: it has a `JobResult.failure` and no rows.

    Raises:
        InputError: The job's settings are such that no run can use them.
    """
    stages = Stages()
    with stages("record"):
        problem = posed(job.command)
    strength = nonlinear_strength(problem)
    try:
        fitness, parameters = _scored(problem, stages)
    except DivergenceError as error:
        return JobResult(pd.DataFrame(), pd.DataFrame(), stages.seconds, strength, str(error).partition("\n")[0])
    return JobResult(fitness, parameters, stages.seconds, strength)


def _scored(problem: Posed, stages: Stages) -> tuple[pd.DataFrame, pd.DataFrame]:
    config, record, truth = problem.config, problem.record, problem.truth
    with stages("estimate"):
        estimate = config.training.solve(problem.problem, config.network, problem.context)
    with stages("baseline"):
        smoothed = config.baseline.solve(problem.problem, problem.context)
    run = config.description
    labels = run.labels_of("pinn")
    fitness = fitness_table(estimate.response, truth.response, record.observed, labels)
    parameters = parameter_table(estimate.parameters, truth.parameters, labels)
    beside = Beside.of(run.baseline, run.labels_of(run.baseline), record, truth, smoothed)
    if beside is not None:
        fitness, parameters = stacked(fitness, beside.fitness), stacked(parameters, beside.parameters)
    return fitness[~fitness["group"].str.startswith("dof_")].reset_index(drop=True), parameters


def nonlinear_strength(problem: Posed) -> float:
    """See `JobResult.strength`; of the true chain and its true motion."""
    true = problem.truth.parameters
    if true is None or "kappa" not in true:
        return float("nan")
    elongation = problem.config.chain.elongation(problem.truth.response.displacement)
    return float(np.max(true["kappa"] * np.mean(elongation**2, axis=0) / true["k"]))


def as_json(result: JobResult) -> dict[str, Any]:
    """What `from_json` reads."""
    tables = {"fitness": result.fitness, "parameters": result.parameters}
    kept = {name: table.astype(object).where(table.notna(), None).to_dict("records") for name, table in tables.items()}
    return {**kept, "seconds": result.seconds, "strength": result.strength, "failure": result.failure}


def from_json(content: Mapping[str, Any]) -> JobResult:
    """The result that `as_json` wrote.

    Raises:
        KeyError: Something is missing.
    """
    fitness, parameters = (pd.DataFrame(content[name]) for name in ("fitness", "parameters"))
    strength = float("nan") if content["strength"] is None else float(content["strength"])
    return JobResult(fitness, parameters, content["seconds"], strength, content["failure"])
