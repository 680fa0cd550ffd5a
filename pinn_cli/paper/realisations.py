"""Realisations of noise (and force) of a problem: network and smoother estimate each, and both are scored.

The scores of each lie in one file, which is made where it is missing or out of date.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.baseline.comparison import baseline_estimate
from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import PreparedProblem, prepare_problem
from pinn_cli.paper.digests import digest_of, keep, kept, run_digest
from pinn_cli.report.record_report import EstimatorTables
from pinn_cli.runs.stages import Stages
from pinn_cli.settings.errors import DivergenceError, InputError
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


Solver = Callable[[Realisation], Scores]


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
    record, truth, context = prepared.record, prepared.truth, RunContext(config.device, config.seed)
    strength = _nonlinear_strength(prepared)
    try:
        with stages("estimate"):
            estimate = config.estimator.solve(prepared.problem, context)
        with stages("baseline"):
            smoothed = baseline_estimate(config.baseline, prepared.problem, context)
    except DivergenceError as error:
        return Scores([], [], stages.seconds, strength, str(error).partition("\n")[0])
    run = config.description
    theirs = EstimatorTables.of(run.baseline, run, smoothed, record, truth) if smoothed else None
    tables = EstimatorTables.of(PINN, run, estimate, record, truth).above(theirs)
    fitness = tables.fitness[~tables.fitness["group"].str.startswith("dof_")]
    return Scores(fitness.to_dict("records"), tables.parameters.to_dict("records"), stages.seconds, strength)


def _nonlinear_strength(prepared: PreparedProblem) -> float | None:
    """See `Scores.strength`; of the true chain and its true motion."""
    true = prepared.truth.parameters
    if true is None or "kappa" not in true:
        return None
    elongation = prepared.true.elongation(prepared.truth.response.displacement)
    return float(np.max(true["kappa"] * np.mean(elongation**2, axis=0) / true["k"]))


@dataclass(frozen=True, eq=False)
class ScoredRealisations:
    """Those realisations whose scores are there and up to date.

    Attributes:
        found: In their order.
        missing: Those without.
        failures: What went wrong, a line each; diverged trainings included.
    """

    found: Mapping[Realisation, Scores]
    missing: Sequence[Realisation]
    failures: Sequence[str]

    @property
    def seconds(self) -> float:
        """That all of them took, one after the other."""
        return sum(float(scores.seconds["total"]) for scores in self.found.values())

    def rows(self, table: str) -> pd.DataFrame:
        """The ``fitness`` or ``parameters`` of all, one below the other.

        The first columns are the realisations' own, with `Scores.strength` where they have any.
        """
        return pd.DataFrame(
            {**({**dict(one.columns), "strength": scores.strength} if one.columns else {}), **row}
            for one, scores in self.found.items()
            for row in getattr(scores, table)
        )


def solve_missing(realisations: Sequence[Realisation], directory: Path, solver: Solver = solve) -> ScoredRealisations:
    """Solve what is missing or out of date, one after the other; each result is kept as it comes.

    Args:
        realisations: In the order in which they are solved.
        directory: Of the scores, ``<name>.json``; created where it is missing.
        solver: Solves one.
    """
    missing, refused = read_scores(realisations, directory).missing, []
    print(f"{len(realisations) - len(missing)} of {len(realisations)} up to date", flush=True)
    for number, realisation in enumerate(missing, start=1):
        start = time.perf_counter()
        try:
            scores = solver(realisation)
        except InputError as error:
            refused.append(f"{realisation.name}: {error}")
            print(f"failed: {refused[-1]}", file=sys.stderr, flush=True)
            continue
        keep(vars(scores), realisation.digest, directory / f"{realisation.name}.json")
        told = f", diverged: {scores.failure}" if scores.failure else ""
        print(f"[{number}/{len(missing)}] {realisation.name}: {time.perf_counter() - start:.1f} s{told}", flush=True)
    scored = read_scores(realisations, directory)
    return ScoredRealisations(scored.found, scored.missing, [*scored.failures, *refused])


def read_scores(realisations: Sequence[Realisation], directory: Path) -> ScoredRealisations:
    """What is there and up to date; nothing is solved."""
    contents = {one: kept(directory / f"{one.name}.json", one.digest) for one in realisations}
    found = {one: Scores(**content) for one, content in contents.items() if content is not None}
    failures = [f"{one.name}: {scores.failure}" for one, scores in found.items() if scores.failure]
    return ScoredRealisations(found, [one for one in realisations if one not in found], failures)
