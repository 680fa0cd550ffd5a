"""One realisation of noise (and force) of a problem: network and smoother estimate it, and both are scored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.baseline.comparison import baseline_estimate
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import PreparedProblem, compose_config, prepare_problem
from pinn_cli.report.record_report import EstimatorTables
from pinn_cli.runs.stages import Stages
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.estimate import RunContext

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

PINN = "pinn"


@dataclass(frozen=True)
class Realisation:
    """A problem whose noise is drawn from one seed.

    Attributes:
        name: Of its file.
        settings: As `pinn-run` takes them, without the seed.
        seed: Of the noise, and of the force where `redraws_force`.
        redraws_force: Whether the phases of the force are drawn anew with each seed.
        columns: Name and value of what says in a table which realisation a row is of, beside the labels that all have.
    """

    name: str
    settings: tuple[str, ...]
    seed: int
    redraws_force: bool = False
    columns: tuple[tuple[str, float], ...] = ()

    @property
    def overrides(self) -> tuple[str, ...]:
        """The settings and the seed. Seeds of single channels, such as the authors', would overrule it."""
        force = (f"excitation.seed={self.seed}",) if self.redraws_force else ()
        return (*self.settings, "noise.seeds=null", f"seed={self.seed}", *force)

    def labels(self, scores: Scores) -> dict[str, float | None]:
        """Its own columns, with `Scores.strength` where it has any."""
        return {**dict(self.columns), "strength": scores.strength} if self.columns else {}


@dataclass(frozen=True, eq=False)
class Scores:
    """What was made of a realisation, as it goes into a JSON file.

    Attributes:
        fitness: Rows as in ``fitness.csv`` of a run with a baseline, groups of several DOFs only.
        parameters: As in its ``parameters.csv``.
        seconds: By stage: ``record`` (configuration and simulation), ``estimate``, ``baseline``, ``total``.
        strength: The largest mean square nonlinear stiffness of a connection over its linear one, kappa rms(e)^2 / k
            for an elongation e; None for chains without kappa.
        failure: Why there is nothing of the network's, in one line; empty where there is.
    """

    fitness: list[dict[Any, Any]]
    parameters: list[dict[Any, Any]]
    seconds: Mapping[str, float]
    strength: float | None
    failure: str = ""


def solve(realisation: Realisation) -> Scores:
    """Estimate a realisation in this process and score what was found.

    A training that diverges is a result too: it has a `Scores.failure` and no rows.

    Raises:
        InputError: The settings are such that no run can use them.
    """
    stages = Stages()
    with stages("record"):
        config = RunConfig.read(compose_config(realisation.overrides))
        prepared = prepare_problem(config)
    strength = _nonlinear_strength(prepared)
    try:
        fitness, parameters = _scored(config, prepared, stages)
    except DivergenceError as error:
        return Scores([], [], stages.seconds, strength, str(error).partition("\n")[0])
    return Scores(fitness.to_dict("records"), parameters.to_dict("records"), stages.seconds, strength)


def _scored(config: RunConfig, prepared: PreparedProblem, stages: Stages) -> tuple[pd.DataFrame, pd.DataFrame]:
    record, truth, context = prepared.record, prepared.truth, RunContext(config.device, config.seed)
    with stages("estimate"):
        estimate = config.estimator.solve(prepared.problem, context)
    with stages("baseline"):
        smoothed = baseline_estimate(config.baseline, prepared.problem, context)
    run = config.description
    theirs = EstimatorTables.of(run.baseline, run, smoothed, record, truth) if smoothed else None
    tables = EstimatorTables.of(PINN, run, estimate, record, truth).above(theirs)
    return tables.fitness[~tables.fitness["group"].str.startswith("dof_")], tables.parameters


def _nonlinear_strength(prepared: PreparedProblem) -> float | None:
    """See `Scores.strength`; of the true chain and its true motion."""
    true = prepared.truth.parameters
    if true is None or "kappa" not in true:
        return None
    elongation = prepared.true.elongation(prepared.truth.response.displacement)
    return float(np.max(true["kappa"] * np.mean(elongation**2, axis=0) / true["k"]))
