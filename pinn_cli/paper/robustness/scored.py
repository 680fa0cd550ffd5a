"""Scores of many realisations: one file each, made where it is missing or out of date."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from pinn_cli.paper.digests import file_digest, run_digest
from pinn_cli.paper.robustness.realisation import Realisation, Scores, solve
from pinn_cli.runs.writing import write_json
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    Solver = Callable[[Realisation], Scores]

# Of this package only this file makes scores: a better table is no reason to solve everything again.
SOLVING = "realisation.py"


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
        """The ``fitness`` or ``parameters`` of all, one below the other, the realisations' own columns first."""
        return pd.DataFrame(
            {**realisation.labels(scores), **row}
            for realisation, scores in self.found.items()
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
        content = {"digest": scores_digest(realisation), **vars(scores)}
        write_json(content, directory / f"{realisation.name}.json")
        told = f", diverged: {scores.failure}" if scores.failure else ""
        print(f"[{number}/{len(missing)}] {realisation.name}: {time.perf_counter() - start:.1f} s{told}", flush=True)
    scored = read_scores(realisations, directory)
    return ScoredRealisations(scored.found, scored.missing, [*scored.failures, *refused])


def read_scores(realisations: Sequence[Realisation], directory: Path) -> ScoredRealisations:
    """What is there and up to date; nothing is solved."""
    found = {one: scores for one in realisations if (scores := _read(one, directory)) is not None}
    failures = [f"{one.name}: {scores.failure}" for one, scores in found.items() if scores.failure]
    return ScoredRealisations(found, [one for one in realisations if one not in found], failures)


def _read(realisation: Realisation, directory: Path) -> Scores | None:
    try:
        content = json.loads((directory / f"{realisation.name}.json").read_text(encoding="utf-8"))
        return Scores(**content) if content.pop("digest") == scores_digest(realisation) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def scores_digest(realisation: Realisation) -> str:
    """SHA-256 of the configuration, the code and the versions that the scores depend on."""
    parts = (_settings_digest(realisation.settings), *realisation.overrides)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@cache
def _settings_digest(settings: tuple[str, ...]) -> str:
    """Without the seed, so that a configuration is composed once for all of its seeds."""
    return run_digest(settings) + file_digest(Path(__file__).with_name(SOLVING))
