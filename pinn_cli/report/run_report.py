"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.report.beside import Beside, stacked
from pinn_cli.report.dataset import response_dataset, write_dataset
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.free_run import free_run, free_run_table
from pinn_cli.report.identifiability import any_unknown, correlation_table, identifiability_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.posterior_table import parameter_estimates, posterior_correlation
from pinn_cli.report.residuals import residual_table
from pinn_cli.report.results import Results
from pinn_cli.report.run_record import run_record
from pinn_cli.report.run_text import Tables, run_text
from pinn_cli.report.score import score_record
from pinn_cli.report.terminal import verdict_text
from pinn_cli.runs.writing import write_json, write_table
from pinn_cli.verdict.judge import judge

if TYPE_CHECKING:
    from pathlib import Path

    from pinn_cli.posterior.findings import PosteriorFindings
    from pinn_cli.record.record import Response
    from pinn_cli.report.free_run import FreeRun
    from pinn_cli.runs.stages import Stages
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.verdict.judge import Verdict

__all__ = ["Results", "write_report"]


def write_report(results: Results, directory: Path, stages: Stages, figures: bool = True) -> str:
    """Write every file of a run; each is there whole or not at all.

    Args:
        results: What came of it.
        directory: Of the run.
        stages: The seconds so far; the report's own are added.
        figures: Whether to draw them, which takes longer than all else.

    Returns:
        What the run prints, from `pinn_cli.report.run_text.run_text`; the verdict comes last.
    """
    run = results.run
    results = replace(results, estimate=_with_posterior(results.estimate, results.posterior))
    beside = Beside.of(run.baseline, run.labels_of(run.baseline), results.record, results.truth, results.baseline)
    with stages("free_run"):
        free = free_run(results.prescribed, results.estimate, results.record)
    with stages("verdict"):
        verdict = _verdict(results, free.response)
    with stages("report"):
        tables = _tables(results, free)
        _write_tables(results, tables, beside, directory)
        _write_response(results, free, beside, directory)
    if figures:
        with stages("figures"):
            _draw(results, beside, directory)
    with stages("posterior_report"):
        diagnostics = _write_posterior(results, directory, figures)
    record_of_run = run_record(run, results.estimate, stages.seconds) | (beside.record if beside else {})
    scored = score_record(run.validation, results.score)
    judged = verdict.record() if verdict else {}
    write_json(record_of_run | _sampling_record(results.posterior) | scored | judged, directory / "run.json")
    text = run_text(results, tables, free, beside, diagnostics, stages.seconds)
    return f"{text}\n\n{verdict_text(verdict)}" if verdict else text


def _tables(results: Results, free: FreeRun) -> Tables:
    record, truth, estimate = results.record, results.truth, results.estimate
    labels = results.run.labels_of(estimator="pinn")
    return Tables(
        fitness=fitness_table(estimate.response, truth.response, record.observed, labels),
        parameters=parameter_table(estimate.parameters, truth.parameters, labels),
        residuals=residual_table(estimate, record, free.response, labels),
        free_run=free_run_table(free, estimate, record, truth.response, results.run.labels_of(estimator="free_run")),
    )


def _write_tables(results: Results, tables: Tables, beside: Beside | None, directory: Path) -> None:
    for name in ("fitness", "parameters", "residuals"):
        table = getattr(tables, name)
        write_table(stacked(table, getattr(beside, name)) if beside else table, directory / f"{name}.csv")
    write_table(tables.free_run, directory / "free_run.csv")
    if any_unknown(results.estimate.parameters):
        _write_identifiability(results.estimate, results.run.labels_of(estimator="pinn"), directory)
    if results.score is not None:
        write_table(results.score.table, directory / "score.csv")
    write_table(results.estimate.history, directory / "history.csv")


def _write_response(results: Results, free: FreeRun, beside: Beside | None, directory: Path) -> None:
    labels, truth = results.run.labels_of(estimator="pinn"), results.truth.response
    dataset = response_dataset(results.estimate, results.record, truth, labels, free.response)
    write_dataset(beside.variables(dataset) if beside else dataset, directory / "response.nc")


def _verdict(results: Results, free: Response | None) -> Verdict | None:
    return None if results.problem is None else judge(results.problem, results.estimate, results.baseline, free)


def _draw(results: Results, beside: Beside | None, directory: Path) -> None:
    # Not above: a sweep's jobs draw nothing and have no need of matplotlib.
    from pinn_cli.report.figures import write_figures

    write_figures(
        results.estimate, results.record, results.truth, directory / "figures", results.linear_response,
        truth_label=results.run.truth_label, units=results.prescribed.units, titles=results.prescribed.titles,
        baseline=(beside.name, beside.estimate.response) if beside else None,
    )  # fmt: skip


def _with_posterior(estimate: Estimate, posterior: PosteriorFindings | None) -> Estimate:
    """The estimate with the parameters' means and intervals from their posterior, where there is one."""
    if posterior is None:
        return estimate
    parameters = parameter_estimates(posterior.samples, [found.parameter for found in estimate.parameters])
    return replace(estimate, parameters=parameters, correlation=posterior_correlation(posterior.samples))


def _write_posterior(results: Results, directory: Path, figures: bool) -> str:
    if results.posterior is None:
        return ""
    # ArviZ takes two seconds to import.
    from pinn_cli.report.bayesian_report import write_posterior

    labels = results.run.labels_of(estimator="pinn")
    true = results.truth.parameters
    return write_posterior(
        results.posterior, results.record, true, labels, results.prescribed.units, directory, figures
    )


def _sampling_record(posterior: PosteriorFindings | None) -> dict[str, Any]:
    """The entry of run.json."""
    if posterior is None:
        return {}
    samples, worst = posterior.samples, posterior.diagnostics
    chains, draws = samples.draws.shape[:2]
    return {
        "posterior": {
            "method": samples.method,
            "chains": chains,
            "warmup": samples.warmup,
            "draws": draws,
            "seconds_by_chain": [round(float(seconds), 3) for seconds in samples.seconds],
            "largest_r_hat": _finite(worst["r_hat"].max()),
            "smallest_ess_bulk": _finite(worst["ess_bulk"].min()),
            "smallest_ess_tail": _finite(worst["ess_tail"].min()),
            "quality_check": list(posterior.verdict) or "passed",
        }
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _write_identifiability(estimate: Estimate, labels: dict[str, object], directory: Path) -> None:
    table = identifiability_table(estimate.parameters, estimate.correlation, labels)
    write_table(table, directory / "identifiability.csv")
    if estimate.correlation is not None:
        write_table(correlation_table(estimate.parameters, estimate.correlation), directory / "correlation.csv")
