"""What a run prints at its end: of a simulated record its fitness first, of a measured one its sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.report import published
from pinn_cli.report.fitness import FORMULAS
from pinn_cli.report.identifiability import identifiability_warnings
from pinn_cli.report.score import score_text
from pinn_cli.report.terminal import fitness_text, free_run_line, free_run_text, parameters_text, sensors_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from pinn_cli.report.beside import Beside
    from pinn_cli.report.free_run import FreeRun
    from pinn_cli.report.results import Results, RunDescription


@dataclass(frozen=True, eq=False)
class Tables:
    """The tables of one run, without a baseline's rows.

    Attributes:
        fitness, parameters, residuals, free_run: The content of the files of these names.
    """

    fitness: pd.DataFrame
    parameters: pd.DataFrame
    residuals: pd.DataFrame
    free_run: pd.DataFrame


def run_text(
    results: Results,
    tables: Tables,
    free: FreeRun,
    beside: Beside | None,
    diagnostics: str,
    seconds: Mapping[str, float],
) -> str:
    """All that a run prints, in paragraphs that an empty line parts.

    A measured record is told sensor by sensor. Its fitness is printed only where sensors were held out, and its free
    run against the sensors only in their table.

    Args:
        results: What came of it, the estimate with its posterior's parameters.
        tables: Of the run.
        free: Its free run.
        beside: What the baseline adds, where there is one.
        diagnostics: The text of a posterior; "" without one.
        seconds: By stage.
    """
    fitness = fitness_text(tables.fitness, results.record.observed, _published(results.run))
    parameters = _parameters_text(results, tables.parameters, beside)
    known = bool(np.isfinite(tables.fitness[list(FORMULAS)].to_numpy()).any())
    free_run = free_run_text(free, tables.free_run) if known else free_run_line(free, tables.free_run)
    shown = [parameters, fitness, free_run, diagnostics]
    if not results.run.simulated:
        shown.insert(0, sensors_text(tables.residuals, (beside.name, beside.residuals) if beside else None))
    shown += [beside.text(tables.fitness, seconds)] if beside else []
    shown += [score_text(results.run.validation, results.score)]
    return "\n\n".join(text for text in shown if text)


def _parameters_text(results: Results, table: pd.DataFrame, beside: Beside | None) -> str:
    estimate = results.estimate
    warnings = identifiability_warnings(estimate.parameters, estimate.correlation)
    baseline = (beside.name, beside.parameters) if beside and len(beside.parameters) else None
    return parameters_text(table, warnings, baseline)


def _published(run: RunDescription) -> pd.DataFrame:
    """The paper's values of the same case; none once a setting that makes it that case was changed."""
    values, labels = published.fitness(), run.labels_of(estimator="pinn")
    same = ["case", "ndof", "nonlinearity", "model_error", "snr_db"]
    return values[(values[same] == [labels[name] for name in same]).all(axis=1)]
