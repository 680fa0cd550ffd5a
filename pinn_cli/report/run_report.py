"""Everything that a run leaves behind, and the text that it prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.report import published
from pinn_cli.report.beside import Beside, stacked
from pinn_cli.report.dataset import response_dataset, write_dataset
from pinn_cli.report.figures import write_figures
from pinn_cli.report.fitness import fitness_table
from pinn_cli.report.parameters import parameter_table
from pinn_cli.report.run_record import run_record
from pinn_cli.report.terminal import fitness_text, parameters_text
from pinn_cli.report.writing import write_json, write_table

if TYPE_CHECKING:
    from pathlib import Path

    import pandas

    from pinn_cli.config import RunConfig
    from pinn_cli.record.record import Record, Response, Truth
    from pinn_cli.stages import Stages
    from pinn_cli.training.estimate import Estimate


def write_report(
    config: RunConfig,
    record: Record,
    truth: Truth,
    estimate: Estimate,
    directory: Path,
    stages: Stages,
    baseline: Estimate | None = None,
) -> str:
    """Write every file of a run; each is there whole or not at all.

    Args:
        config: What was run.
        record: What the estimator saw.
        truth: What it is scored against; NaN where unknown.
        estimate: What it found.
        directory: Of the run.
        stages: The seconds so far; the report's own are added.
        baseline: What the configured baseline found; None where there is none.

    Returns:
        The tables of parameters and fitness, and of both estimators where there is a baseline, as text.
    """
    labels = config.labels(estimator="pinn")
    with stages("report"):
        fitness = fitness_table(estimate.response, truth.response, record.observed, labels)
        parameters = parameter_table(estimate.parameters, truth.parameters, labels)
        beside = Beside.of(config, record, truth, baseline)
        write_table(stacked(fitness, beside.fitness) if beside else fitness, directory / "fitness.csv")
        write_table(stacked(parameters, beside.parameters) if beside else parameters, directory / "parameters.csv")
        write_table(estimate.history, directory / "history.csv")
        dataset = response_dataset(estimate, record, truth.response, labels)
        write_dataset(beside.variables(dataset) if beside else dataset, directory / "response.nc")
    with stages("figures"):
        write_figures(
            estimate, record, truth, directory / "figures", _equivalent_linear(config), truth_label=config.truth_label,
            baseline=(beside.name, beside.estimate.response) if beside else None,
        )  # fmt: skip
    record_of_run = run_record(config, estimate, stages.seconds) | (beside.record if beside else {})
    write_json(record_of_run, directory / "run.json")
    shown = [parameters_text(parameters), fitness_text(fitness, record.observed, _published(labels))]
    shown += [beside.text(fitness, stages.seconds)] if beside else []
    return "\n\n".join(text for text in shown if text)


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
