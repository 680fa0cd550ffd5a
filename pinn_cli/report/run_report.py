"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.report import published
from pinn_cli.report.dataset import response_dataset, write_dataset
from pinn_cli.report.figures import write_figures
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.free_run import free_run, free_run_table
from pinn_cli.report.identifiability import (
    any_unknown,
    correlation_table,
    identifiability_table,
    identifiability_warnings,
)
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.run_record import run_record
from pinn_cli.report.terminal import fitness_text, free_run_text, parameters_text
from pinn_cli.report.writing import write_json, write_table

if TYPE_CHECKING:
    from pathlib import Path

    import pandas

    from pinn_cli.config import RunConfig
    from pinn_cli.record.record import Record, Response, Truth
    from pinn_cli.stages import Stages
    from pinn_cli.training.estimate import Estimate


def write_report(
    config: RunConfig, record: Record, truth: Truth, estimate: Estimate, directory: Path, stages: Stages
) -> str:
    """Write every file of a run; each is there whole or not at all.

    Args:
        config: What was run.
        record: What the estimator saw.
        truth: What it is scored against; NaN where unknown.
        estimate: What it found.
        directory: Of the run.
        stages: The seconds so far; the report's own are added.

    Returns:
        The tables of parameters, fitness and the free run, as text.
    """
    labels = config.labels(estimator="pinn")
    with stages("free_run"):
        _, prescribed = config.model_error.chains(config.chain)
        free = free_run(prescribed, estimate, record)
        free_table = free_run_table(free, estimate, record, truth.response, config.labels(estimator="free_run"))
    with stages("report"):
        fitness = fitness_table(estimate.response, truth.response, record.observed, labels)
        parameters = parameter_table(estimate.parameters, truth.parameters, labels)
        write_table(fitness, directory / "fitness.csv")
        write_table(parameters, directory / "parameters.csv")
        write_table(free_table, directory / "free_run.csv")
        if any_unknown(estimate.parameters):
            _write_identifiability(estimate, labels, directory)
        write_table(estimate.history, directory / "history.csv")
        dataset = response_dataset(estimate, record, truth.response, labels, free.response)
        write_dataset(dataset, directory / "response.nc")
    with stages("figures"):
        write_figures(
            estimate,
            record,
            truth,
            directory / "figures",
            _equivalent_linear(config),
            truth_label=config.truth_label,
            units=config.chain.units,
        )
    write_json(run_record(config, estimate, stages.seconds), directory / "run.json")
    shown = [_parameters_text(parameters, estimate), fitness_text(fitness, record.observed, _published(labels))]
    shown.append(free_run_text(free, free_table))
    return "\n\n".join(text for text in shown if text)


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
