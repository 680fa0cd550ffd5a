"""What came of a run, read from the files that it left."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pinn_cli.report.fitness import FORMULAS
from pinn_cli.runs.lock import FILE as LOCK
from pinn_cli.runs.reading import read_table
from pinn_cli.runs.resume import TRACKING as STATE
from pinn_cli.runs.resume import read_record

# Not copied: what only this program reads, and is large or gone when the run is, and what other trackers wrote.
LEFT_OUT = ("checkpoint.pt", "checkpoint.previous.pt", STATE, LOCK, "tensorboard", "chains")


@dataclass(frozen=True)
class Outcome:
    """Of a run that has ended.

    Attributes:
        metrics: Name to value, finite: ``fitness_percent/displacement``, ``error_percent/k_2``, ``seconds/total``, ...
        figures: As PNG.
        files: Files and folders to keep.
    """

    metrics: dict[str, float]
    figures: list[Path]
    files: list[Path]

    @classmethod
    def read(cls, directory: Path) -> Outcome:
        """Of the run in a directory."""
        metrics = {**_fitness(directory), **_errors(directory), **_record(directory)}
        finite = {name: float(value) for name, value in metrics.items() if pd.notna(value)}
        files = [entry for entry in sorted(directory.iterdir()) if entry.name not in LEFT_OUT]
        return cls(finite, sorted((directory / "figures").glob("*.png")), files)


def history(directory: Path) -> list[dict[str, float]]:
    """Rows of the history of the run in a directory, as it went through them."""
    table = read_table(directory / "history.csv")
    return [{str(name): float(v) for name, v in row.items() if pd.notna(v)} for row in table.to_dict("records")]


def _fitness(directory: Path) -> dict[str, float]:
    """Of all DOFs, by quantity; a baseline's under its own name."""
    table = read_table(directory / "fitness.csv", FORMULAS, ("estimator", "group", "quantity"))
    table = table[table["group"] == "all"]
    return {
        f"{_of(row['estimator'])}{column}/{row['quantity']}": row[column]
        for _, row in table.iterrows()
        for column in FORMULAS
    }


def _errors(directory: Path) -> dict[str, float]:
    table = read_table(directory / "parameters.csv", ("error_percent",), ("estimator", "parameter"))
    return {
        f"{_of(row['estimator'])}error_percent/{row['parameter']}": row["error_percent"] for _, row in table.iterrows()
    }


def _of(estimator: str) -> str:
    return "" if estimator == "pinn" else f"{estimator}/"


def _record(directory: Path) -> dict[str, float | None]:
    record = read_record(directory)
    found: dict[str, float | None] = {f"seconds/{name}": value for name, value in record.get("seconds", {}).items()}
    numbers = record.get("training", {}).items()
    found |= {f"training/{name}": v for name, v in numbers if isinstance(v, int | float) and not isinstance(v, bool)}
    score = record.get("validation", {}).get("score")
    return found if score is None else {**found, "validation_score": score}
