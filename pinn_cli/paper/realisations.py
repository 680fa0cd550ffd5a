"""Realisations of noise (and force) of a problem: network and smoother estimate each, and both are scored."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.baseline import baseline_estimate
from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.paper.runs import digest_of, kept, make_missing, run_digest
from pinn_cli.report.run_report import below, estimator_tables
from pinn_cli.runs.stages import Stages
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.estimate import RunContext

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

    @property
    def digest(self) -> str:
        """Of the configuration, the code and the versions that its scores depend on."""
        return digest_of("\0".join((_settings_digest(self.settings), *self.overrides)))


@cache
def _settings_digest(settings: tuple[str, ...]) -> str:
    """Without the seed, so that a configuration is composed once for all of its seeds."""
    # Of this package only this file makes scores: a better table is no reason to solve everything again.
    return run_digest(settings) + digest_of(Path(__file__).read_bytes())


Solver = Callable[[Realisation], Mapping[str, Any]]


def solve(realisation: Realisation) -> dict[str, Any]:
    """Estimate a realisation in this process and score what was found, as it goes into a JSON file.

    Returns:
        ``fitness`` and ``parameters``: rows as in these files of a run with a baseline, of groups of several DOFs only.
        ``seconds`` by stage: ``record`` (configuration and simulation), ``estimate``, ``baseline``, ``total``.
        ``strength``: the largest mean square nonlinear stiffness of a connection over its linear one, kappa rms(e)^2 /
        k for an elongation e; None for chains without kappa. ``failure``: of a training that diverged, which is a
        result too and has no rows, the reason in one line.

    Raises:
        InputError: The settings are such that no run can use them.
    """
    stages = Stages()
    with stages("record"):
        config = RunConfig.read(compose_config(realisation.overrides))
        prepared = prepare_problem(config)
    record, truth, context = prepared.record, prepared.truth, RunContext(config.device, config.seed)
    true, strength = truth.parameters, None
    if true is not None and "kappa" in true:
        elongation = prepared.true.elongation(truth.response.displacement)
        strength = float(np.max(true["kappa"] * np.mean(elongation**2, axis=0) / true["k"]))
    scores: dict[str, Any] = {"fitness": [], "parameters": [], "strength": strength, "failure": ""}
    try:
        with stages("estimate"):
            estimate = config.estimator.solve(prepared.problem, context)
        with stages("baseline"):
            smoothed = baseline_estimate(config.baseline, prepared.problem, context)
    except DivergenceError as error:
        return scores | {"seconds": stages.seconds, "failure": str(error).partition("\n")[0]}
    run = config.description
    estimates = {PINN: estimate} | ({run.baseline: smoothed} if smoothed else {})
    tables = [estimator_tables(name, run, of_estimator, record, truth) for name, of_estimator in estimates.items()]
    fitness, parameters = (below(*parts) for parts in zip(*tables, strict=True))
    fitness = fitness[~fitness["group"].str.startswith("dof_")]
    rows = {"fitness": fitness.to_dict("records"), "parameters": parameters.to_dict("records")}
    return scores | rows | {"seconds": stages.seconds}


@dataclass(frozen=True, eq=False)
class ScoredRealisations:
    """Those realisations whose scores are there and up to date.

    Attributes:
        by_realisation: To each its scores, as `solve` returns them.
        missing: Those without.
        failures: What went wrong, a line each; diverged trainings included.
    """

    by_realisation: Mapping[Realisation, Mapping[str, Any]]
    missing: Sequence[Realisation]
    failures: Sequence[str]

    @classmethod
    def read(
        cls, realisations: Sequence[Realisation], directory: Path, refused: Sequence[str] = ()
    ) -> ScoredRealisations:
        """What is there and up to date in a folder of ``<name>.json``, and why some were refused; nothing is solved."""
        contents = {realisation: kept(realisation, directory) for realisation in realisations}
        scored = {realisation: content for realisation, content in contents.items() if content is not None}
        failures = [f"{item.name}: {scores['failure']}" for item, scores in scored.items() if scores["failure"]]
        return cls(scored, [item for item in realisations if item not in scored], [*failures, *refused])

    @classmethod
    def made(cls, realisations: Sequence[Realisation], directory: Path, solver: Solver = solve) -> ScoredRealisations:
        """The same, once what is missing or out of date was solved, one after the other."""
        return cls.read(realisations, directory, make_missing(realisations, directory, solver))

    @property
    def seconds(self) -> float:
        """That all of them took, one after the other."""
        return sum(float(scores["seconds"]["total"]) for scores in self.by_realisation.values())

    def rows(self, table: str) -> pd.DataFrame:
        """The ``fitness`` or ``parameters`` of all, one below the other.

        The first columns are the realisations' own, with the strength where they have any.
        """
        return pd.DataFrame(
            {**({**dict(realisation.columns), "strength": scores["strength"]} if realisation.columns else {}), **row}
            for realisation, scores in self.by_realisation.items()
            for row in scores[table]
        )
