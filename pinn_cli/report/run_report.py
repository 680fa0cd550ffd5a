"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pinn_cli.report import published
from pinn_cli.report.beside import Beside, stacked
from pinn_cli.report.dataset import response_dataset, write_dataset
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.free_run import free_run, free_run_table
from pinn_cli.report.identifiability import (
    any_unknown,
    correlation_table,
    identifiability_table,
    identifiability_warnings,
)
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.posterior_table import parameter_estimates, posterior_correlation
from pinn_cli.report.run_record import run_record
from pinn_cli.report.score import score_record, score_text
from pinn_cli.report.terminal import fitness_text, free_run_text, parameters_text, verdict_text
from pinn_cli.report.writing import write_json, write_table
from pinn_cli.verdict.judge import judge

if TYPE_CHECKING:
    from pathlib import Path

    import pandas

    from pinn_cli.config import RunConfig
    from pinn_cli.posterior.findings import PosteriorFindings
    from pinn_cli.record.record import Record, Response, Truth
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.stages import Stages
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.validation.base import Score
    from pinn_cli.verdict.judge import Verdict


@dataclass(frozen=True, eq=False)
class Results:
    """All that a run has found.

    Attributes:
        record: What the estimator saw.
        truth: What it is scored against; NaN where unknown.
        estimate: What it found.
        baseline: What the configured baseline found; None where there is none.
        posterior: Of the parameters, where one was asked for.
        score: Of the estimate without the truth, where one was asked for.
        problem: That was solved; without it there is no verdict.
    """

    record: Record
    truth: Truth
    estimate: Estimate
    baseline: Estimate | None = None
    posterior: PosteriorFindings | None = None
    score: Score | None = None
    problem: Problem | None = None


def write_report(config: RunConfig, results: Results, directory: Path, stages: Stages, figures: bool = True) -> str:
    """Write every file of a run; each is there whole or not at all.

    Args:
        config: What was run.
        results: What came of it.
        directory: Of the run.
        stages: The seconds so far; the report's own are added.
        figures: Whether to draw them, which takes longer than all else.

    Returns:
        The tables of parameters, fitness, the free run and, where there are some, of the posterior's diagnostics and
        both estimators, as text; the verdict comes last.
    """
    record, truth, labels = results.record, results.truth, config.labels(estimator="pinn")
    estimate = _with_posterior(results.estimate, results.posterior)
    beside = Beside.of(config, record, truth, results.baseline)
    with stages("free_run"):
        _, prescribed = config.model_error.chains(config.chain)
        free = free_run(prescribed, estimate, record)
        free_table = free_run_table(free, estimate, record, truth.response, config.labels(estimator="free_run"))
    with stages("verdict"):
        verdict = _verdict(results, estimate, free.response)
    with stages("report"):
        fitness = fitness_table(estimate.response, truth.response, record.observed, labels)
        parameters = parameter_table(estimate.parameters, truth.parameters, labels)
        write_table(stacked(fitness, beside.fitness) if beside else fitness, directory / "fitness.csv")
        write_table(stacked(parameters, beside.parameters) if beside else parameters, directory / "parameters.csv")
        write_table(free_table, directory / "free_run.csv")
        if any_unknown(estimate.parameters):
            _write_identifiability(estimate, labels, directory)
        if results.score is not None:
            write_table(results.score.table, directory / "score.csv")
        write_table(estimate.history, directory / "history.csv")
        dataset = response_dataset(estimate, record, truth.response, labels, free.response)
        write_dataset(beside.variables(dataset) if beside else dataset, directory / "response.nc")
    if figures:
        with stages("figures"):
            _draw(config, replace(results, estimate=estimate), beside, directory)
    with stages("posterior_report"):
        diagnostics = _write_posterior(config, results, directory, figures)
    record_of_run = run_record(config, estimate, stages.seconds) | (beside.record if beside else {})
    scored = score_record(config.validation.name, results.score)
    judged = verdict.record() if verdict else {}
    write_json(record_of_run | _sampling_record(results.posterior) | scored | judged, directory / "run.json")
    shown = [_parameters_text(parameters, estimate), fitness_text(fitness, record.observed, _published(labels))]
    shown += [free_run_text(free, free_table), diagnostics]
    shown += [beside.text(fitness, stages.seconds)] if beside else []
    shown += [score_text(config.validation.name, results.score), verdict_text(verdict) if verdict else ""]
    return "\n\n".join(text for text in shown if text)


def _verdict(results: Results, estimate: Estimate, free: Response | None) -> Verdict | None:
    return None if results.problem is None else judge(results.problem, estimate, results.baseline, free)


def _draw(config: RunConfig, results: Results, beside: Beside | None, directory: Path) -> None:
    # Not above: a sweep's jobs draw nothing and have no need of matplotlib.
    from pinn_cli.report.figures import write_figures

    write_figures(
        results.estimate, results.record, results.truth, directory / "figures", _equivalent_linear(config),
        truth_label=config.truth_label, units=config.chain.units,
        baseline=(beside.name, beside.estimate.response) if beside else None,
    )  # fmt: skip


def _with_posterior(estimate: Estimate, posterior: PosteriorFindings | None) -> Estimate:
    """The estimate with the parameters' means and intervals from their posterior, where there is one."""
    if posterior is None:
        return estimate
    start = {parameter.name: parameter.prescribed for parameter in estimate.parameters}
    parameters = parameter_estimates(posterior.samples, start)
    return replace(estimate, parameters=parameters, correlation=posterior_correlation(posterior.samples))


def _write_posterior(config: RunConfig, results: Results, directory: Path, figures: bool) -> str:
    if results.posterior is None:
        return ""
    # ArviZ takes two seconds to import.
    from pinn_cli.report.bayesian_report import write_posterior

    labels = config.labels(estimator="pinn")
    true = results.truth.parameters
    return write_posterior(results.posterior, results.record, true, labels, config.chain.units, directory, figures)


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


def _parameters_text(table: pandas.DataFrame, estimate: Estimate) -> str:
    unknown = [p.name for p in estimate.parameters if p.unknown]
    return parameters_text(table, unknown, identifiability_warnings(estimate.parameters, estimate.correlation))


def _equivalent_linear(config: RunConfig) -> Response | None:
    """The linear chain under the same force, for the figure of a linear model error (paper, Fig. 6)."""
    if not config.source.simulated or config.model_error.name != "linear":
        return None
    true, _ = config.model_error.chains(config.chain)
    return config.source.measure(true.linearised()).truth.response


def _published(labels: dict[str, object]) -> pandas.DataFrame:
    """The paper's values of the same case; none once a setting that makes it that case was changed."""
    values = published.fitness()
    same = ["case", "ndof", "nonlinearity", "model_error", "snr_db"]
    return values[(values[same] == [labels[name] for name in same]).all(axis=1)]
