"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pinn_cli.report.connection_forces import ConnectionForces
from pinn_cli.report.dataset import response_dataset, write_dataset
from pinn_cli.report.drift import Drifts, drift_table
from pinn_cli.report.energy import DissipatedEnergy, energy_table
from pinn_cli.report.free_run import free_run, free_run_table
from pinn_cli.report.modes import ModeEstimates, mode_table
from pinn_cli.report.parameters import any_unknown, correlation_table, identifiability_table
from pinn_cli.report.posterior import (
    diagnostics_table,
    parameter_estimates,
    posterior_correlation,
    posterior_groups,
    write_posterior_data,
)
from pinn_cli.report.run_record import run_record
from pinn_cli.report.tables import EstimatorTables
from pinn_cli.report.terminal.parameters import diagnostics_text
from pinn_cli.report.terminal.run import run_text
from pinn_cli.report.terminal.validation import validation_text
from pinn_cli.report.validation_run import ValidationRun, validation_table
from pinn_cli.runs.writing import write_json, write_table
from pinn_cli.verdict.judge import judge

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd

    from pinn_cli.report.export.base import Export
    from pinn_cli.report.results import Results
    from pinn_cli.runs.stages import Stages


def write_report(
    results: Results, directory: Path, stages: Stages, figures: bool = True, exports: Sequence[Export] = ()
) -> str:
    """Write every file of a run; each is there whole or not at all.

    Args:
        results: What came of it.
        directory: Of the run.
        stages: The seconds so far; the report's own are added.
        figures: Whether to draw them, which takes longer than all else.
        exports: Formats in which the response is written beside ``response.nc``.

    Returns:
        What the run prints, from `pinn_cli.report.terminal.run.run_text`; the verdict comes last.
    """
    results = _with_posterior(results)
    run, estimate, record, truth = results.run, results.estimate, results.record, results.truth
    with stages("free_run"):
        free = free_run(results.prescribed, estimate, record)
    with stages("verdict"):
        problem, other = results.problem, results.baseline
        verdict = judge(problem, estimate, other, free.response) if problem else None
    with stages("report"):
        tables = EstimatorTables.of("pinn", run, estimate, record, truth, free.response)
        baseline = EstimatorTables.of(run.baseline, run, other, record, truth) if other else None
        free_table = free_run_table(free, estimate, record, truth.response, run.labels_of(estimator="free_run"))
        write_table(free_table, directory / "free_run.csv")
        _write_tables(results, tables.above(baseline), directory)
        labels, named = run.labels_of(estimator="pinn"), (run.baseline, other) if other else None
        drifts = Drifts.of(results.prescribed, estimate, truth.response)
        write_table(drift_table(drifts, labels), directory / "drift.csv")
        energy = DissipatedEnergy.of(results.prescribed, estimate, truth.response, results.true)
        write_table(energy_table(energy, labels), directory / "energy.csv")
        forces = ConnectionForces.of(results.prescribed, estimate, truth)
        dataset = response_dataset(estimate, record, truth.response, labels, free.response, named, drifts, forces)
        write_dataset(dataset, directory / "response.nc")
        for export in exports:
            export.write(dataset, directory / f"response.{export.name}")
    validation = _validation(results, directory, stages)
    if figures:
        with stages("figures"):
            _draw(results, directory)
            if validation is not None:
                _draw_validation(results, validation[0], directory)
    with stages("posterior_report"):
        diagnostics = write_posterior(results, directory, figures)
    write_json(run_record(results, verdict, stages.seconds), directory / "run.json")
    paragraphs = diagnostics, "" if validation is None else validation_text(*validation)
    return run_text(results, tables, baseline, (free, free_table), paragraphs, verdict, stages.seconds)


def _with_posterior(results: Results) -> Results:
    """The parameters' means and intervals from their posterior, where there is one."""
    if results.posterior is None:
        return results
    samples, estimate = results.posterior.samples, results.estimate
    parameters = parameter_estimates(samples, [found.parameter for found in estimate.parameters])
    correlation = posterior_correlation(samples.pooled)
    return replace(results, estimate=replace(estimate, parameters=parameters, correlation=correlation))


def _write_tables(results: Results, tables: EstimatorTables, directory: Path) -> None:
    estimate, labels = results.estimate, results.run.labels_of(estimator="pinn")
    parameters, correlation = estimate.parameters, estimate.correlation
    files: dict[str, Any] = {
        "fitness": tables.fitness, "parameters": tables.parameters, "residuals": tables.residuals,
        "history": estimate.history,
    }  # fmt: skip
    modes = ModeEstimates.of(results.prescribed, estimate, results.true)
    if modes is not None:
        files["modes"] = mode_table(modes, labels)
    if results.score is not None:
        files["score"] = results.score.table
    if any_unknown(parameters):
        files["identifiability"] = identifiability_table(parameters, correlation, labels)
        if correlation is not None:
            files["correlation"] = correlation_table(parameters, correlation)
    for name, table in files.items():
        write_table(table, directory / f"{name}.csv")


def _validation(results: Results, directory: Path, stages: Stages) -> tuple[ValidationRun, pd.DataFrame] | None:
    """Try the identified system on other data, and write ``validation.csv``; None without such data."""
    if results.validation is None:
        return None
    draws = None if results.posterior is None else results.posterior.samples.pooled
    with stages("validation_data"):
        run = ValidationRun.of(
            results.prescribed, results.estimate, results.record, results.validation, draws, results.run.seed
        )
        table = validation_table(run, results.estimate, results.run.labels_of(estimator="pinn"))
        write_table(table, directory / "validation.csv")
    return run, table


def _draw_validation(results: Results, run: ValidationRun, directory: Path) -> None:
    from pinn_cli.report.figures import write_validation_figure

    if run.response is not None:
        write_validation_figure(run, results.estimate, directory / "figures")


def _draw(results: Results, directory: Path) -> None:
    # Not above: a sweep's jobs draw nothing and have no need of matplotlib.
    from pinn_cli.report.figures import write_figures

    write_figures(results, directory / "figures")


def write_posterior(results: Results, directory: Path, figures: bool) -> str:
    """Write ``posterior.nc``, ``diagnostics.csv`` and the posterior's figures; its diagnostics and verdict as text."""
    if results.posterior is None:
        return ""
    posterior, labels = results.posterior, results.run.labels_of(estimator="pinn")
    parameters = [found.parameter for found in results.estimate.parameters]
    groups = posterior_groups(posterior, results.record, parameters, labels)
    write_posterior_data(groups, directory / "posterior.nc")
    write_table(diagnostics_table(posterior.diagnostics, labels), directory / "diagnostics.csv")
    if figures:
        from pinn_cli.report.figures import write_posterior_figures

        write_posterior_figures(results, groups, directory / "figures")
    return diagnostics_text(posterior.diagnostics, posterior.verdict)
