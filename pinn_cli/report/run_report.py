"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pinn_cli.report.modes import ModeEstimates, mode_table
from pinn_cli.report.parameters import any_unknown, correlation_table, identifiability_table, parameter_table
from pinn_cli.report.posterior import (
    diagnostics_table,
    parameter_estimates,
    posterior_correlation,
    posterior_groups,
    write_posterior_data,
)
from pinn_cli.report.record_report import RecordReport, record_folder, records_table
from pinn_cli.report.run_record import run_record
from pinn_cli.report.tables import EstimatorTables
from pinn_cli.report.terminal.parameters import diagnostics_text
from pinn_cli.report.terminal.run import run_text
from pinn_cli.report.terminal.validation import validation_text
from pinn_cli.report.validation_run import ValidationRun, validation_table
from pinn_cli.runs.side_by_side import side_by_side
from pinn_cli.runs.writing import write_json, write_table
from pinn_cli.verdict.records import verdict_of_records

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
    run, other = results.run, results.baseline
    named = (run.baseline, other) if other else None
    reports = [
        RecordReport(own, directory / record_folder(number), named if number == 1 else None, exports)
        for number, own in enumerate(results.by_record, start=1)
    ]
    records = side_by_side(reports, [len(report.results.record.time) for report in reports])
    with stages("free_run"):
        free = records.each(RecordReport.run_free, [report is reports[0] for report in reports])[0]
    with stages("verdict"):
        verdicts = records.each(RecordReport.verdict)
        verdict = verdict_of_records(verdicts)
    with stages("report"):
        (tables, baseline), *others = records.each(RecordReport.write)
        every, further = results.estimate.parameters, [own for own, _ in others]
        labels = run.labels_of(estimator="pinn")
        tables = replace(tables, parameters=parameter_table(every, results.truth.parameters, labels))
        _write_tables(results, tables.above(baseline), directory)
        if further:
            rows = list(zip(results.by_record, (tables, *further), verdicts, strict=True))
            write_table(records_table(rows), directory / "records.csv")
    validation = _validation(results, directory, stages)
    if figures:
        with stages("figures"):
            records.each(RecordReport.draw)
            _draw(results, directory)
            if validation is not None:
                _draw_validation(results, validation[0], directory)
    with stages("posterior_report"):
        diagnostics = write_posterior(results, directory, figures)
    write_json(run_record(results, verdict, stages.seconds), directory / "run.json")
    assert free is not None
    paragraphs = diagnostics, "" if validation is None else validation_text(*validation)
    return run_text(results, tables, baseline, free, paragraphs, verdict, stages.seconds, further)


def _with_posterior(results: Results) -> Results:
    """The parameters' means and intervals from their posterior, where there is one."""
    if results.posterior is None:
        return results
    samples = results.posterior.samples
    parameters = parameter_estimates(samples, [found.parameter for found in results.estimate.parameters])
    correlation = posterior_correlation(samples.pooled)

    def sampled(own: Results) -> Results:
        return replace(own, estimate=replace(own.estimate, parameters=parameters, correlation=correlation))

    return replace(sampled(results), further=tuple(map(sampled, results.further)))


def _write_tables(results: Results, tables: EstimatorTables, directory: Path) -> None:
    estimate, labels = results.estimate, results.run.labels_of(estimator="pinn")
    parameters, correlation = estimate.parameters, estimate.correlation
    files: dict[str, Any] = {"parameters": tables.parameters, "history": estimate.history}
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
    from pinn_cli.report.figures import write_run_figures

    write_run_figures(results, directory / "figures")


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
