"""The figures of a run. Importing this package imports matplotlib; do so when a run has something to draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.report.figures.correlation import correlation_figure
from pinn_cli.report.figures.error_map import error_map_figure
from pinn_cli.report.figures.force_predictive import force_predictive_figure
from pinn_cli.report.figures.history import history_figure
from pinn_cli.report.figures.parameters import parameters_figure
from pinn_cli.report.figures.posterior import IN_TRACES, posterior_pairs_figure, rank_figure, trace_figure
from pinn_cli.report.figures.residuals import residuals_figure
from pinn_cli.report.figures.response import response_figure
from pinn_cli.report.figures.style import save
from pinn_cli.report.parameters import any_unknown, true_value
from pinn_cli.report.posterior_table import worst_sampled

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np
    import xarray as xr

    from pinn_cli.posterior.result import PosteriorResult
    from pinn_cli.record.record import Record
    from pinn_cli.report.results import Results


def write_figures(results: Results, directory: Path | str) -> list[Path]:
    """Draw and save every figure that the run has something for, as PNG and PDF, in ``directory``.

    Returns:
        The files written.
    """
    estimate, record, truth, run = results.estimate, results.record, results.truth, results.run
    baseline = (run.baseline, results.baseline.response) if results.baseline else None
    figures = {
        "response": response_figure(
            estimate, record, truth.response, results.linear_response, run.truth_label, baseline
        ),
        "residuals": residuals_figure(estimate, record),
        "error_map": error_map_figure(estimate, record, truth.response),
    }
    if any(str(name).startswith(("loss_", "weight_")) for name in estimate.history):
        figures["history"] = history_figure(estimate.history)
    if any(given.prescribed or given.unknown for given in estimate.parameters):
        chain = results.prescribed
        figures["parameters"] = parameters_figure(estimate.parameters, truth.parameters, chain.units, chain.titles)
    if estimate.correlation is not None and len(estimate.parameters) > 1 and any_unknown(estimate.parameters):
        figures["correlation"] = correlation_figure(estimate.parameters, estimate.correlation)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]


def write_posterior_figures(
    posterior: PosteriorResult,
    groups: Mapping[str, xr.Dataset],
    record: Record,
    true: Mapping[str, np.ndarray] | None,
    directory: Path,
) -> list[Path]:
    """Draw and save ``posterior_pairs`` and, where there is something to draw, ``trace``, ``ranks``, ``fitted_force``.

    Traces and ranks are those of the parameters with the fewest effective draws; draws that did not come step by step
    have neither.

    Returns:
        The files written.
    """
    samples, draws = posterior.samples, groups["posterior"]
    figures = {
        "posterior_pairs": posterior_pairs_figure(draws, {name: true_value(name, true) for name in samples.names})
    }
    if samples.statistics:
        parameters = posterior.diagnostics[posterior.diagnostics["parameter"].isin(samples.names)]
        shown = worst_sampled(parameters, IN_TRACES)
        figures["trace"] = trace_figure(draws, groups["sample_stats"], shown)
        figures["ranks"] = rank_figure(draws, shown)
    if posterior.predictive is not None:
        figures["fitted_force"] = force_predictive_figure(posterior.predictive, record, samples.force_dofs)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]
