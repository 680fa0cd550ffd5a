"""The figures of a run. Importing this package imports matplotlib; do so when a run has something to draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.report.figures.correlation import correlation_figure
from pinn_cli.report.figures.error_map import error_map_figure
from pinn_cli.report.figures.history import history_figure
from pinn_cli.report.figures.parameters import parameters_figure
from pinn_cli.report.figures.residuals import residuals_figure
from pinn_cli.report.figures.response import response_figure
from pinn_cli.report.figures.style import save
from pinn_cli.report.identifiability import any_unknown

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pinn_cli.record.record import Record, Response, Truth
    from pinn_cli.training.estimate import Estimate

__all__ = [
    "correlation_figure",
    "error_map_figure",
    "history_figure",
    "parameters_figure",
    "residuals_figure",
    "response_figure",
    "save",
    "write_figures",
]


def write_figures(
    estimate: Estimate,
    record: Record,
    truth: Truth,
    directory: Path | str,
    linear: Response | None = None,
    truth_label: str = "truth",
    units: Mapping[str, str] | None = None,
    titles: Mapping[str, str] | None = None,
    baseline: tuple[str, Response] | None = None,
) -> list[Path]:
    """Draw and save every figure that the run has something for, as PNG and PDF.

    Args:
        estimate: Response, standard deviations, parameters and history.
        record: What the estimator saw.
        truth: For comparison; NaN where unknown.
        directory: The run's folder of figures; created where it is missing.
        linear: The true response of the equivalent linear system, if it is to be shown.
        truth_label: What the legend calls the truth.
        units: Symbol of a parameter to its unit, powers as ``m^3``.
        titles: Symbol of a parameter to its name in words.
        baseline: Name and response of another estimator, drawn in the figure of the response.

    Returns:
        The files written.
    """
    figures = {
        "response": response_figure(estimate, record, truth.response, linear, truth_label, baseline),
        "residuals": residuals_figure(estimate, record),
        "error_map": error_map_figure(estimate, record, truth.response),
    }
    if any(str(name).startswith(("loss_", "weight_")) for name in estimate.history):
        figures["history"] = history_figure(estimate.history)
    if any(given.prescribed or given.unknown for given in estimate.parameters):
        figures["parameters"] = parameters_figure(estimate.parameters, truth.parameters, units, titles)
    if estimate.correlation is not None and len(estimate.parameters) > 1 and any_unknown(estimate.parameters):
        figures["correlation"] = correlation_figure(estimate.parameters, estimate.correlation)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]
