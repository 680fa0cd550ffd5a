"""The figures of a run. Importing this package imports matplotlib; do so when a run has something to draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.report.connection_forces import ConnectionForces
from pinn_cli.report.drift import Drifts
from pinn_cli.report.figures.correlation import correlation_figure
from pinn_cli.report.figures.drift import drift_figure
from pinn_cli.report.figures.error_map import error_map_figure
from pinn_cli.report.figures.force_predictive import force_predictive_figure
from pinn_cli.report.figures.history import history_figure
from pinn_cli.report.figures.hysteresis import hysteresis_figure
from pinn_cli.report.figures.modes import modes_figure
from pinn_cli.report.figures.parameters import parameters_figure
from pinn_cli.report.figures.posterior import IN_TRACES, posterior_pairs_figure, rank_figure, trace_figure
from pinn_cli.report.figures.residuals import residuals_figure
from pinn_cli.report.figures.response import response_figure
from pinn_cli.report.figures.structure import structure_figure
from pinn_cli.report.figures.style import save
from pinn_cli.report.figures.validation import validation_figure
from pinn_cli.report.modes import ModeEstimates
from pinn_cli.report.parameters import any_unknown
from pinn_cli.report.posterior import worst_sampled

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import xarray as xr

    from pinn_cli.report.results import Results
    from pinn_cli.report.validation_run import ValidationRun
    from pinn_cli.training.estimate import Estimate


def write_figures(results: Results, directory: Path | str) -> list[Path]:
    """Draw and save every figure that the run has something for, as PNG and PDF, in ``directory``.

    Returns:
        The files written.
    """
    return write_record_figures(results, directory) + write_run_figures(results, directory)


def write_run_figures(results: Results, directory: Path | str) -> list[Path]:
    """Those that are about parameters and training, which several records have in common.

    Returns:
        The files written.
    """
    estimate, truth, figures = results.estimate, results.truth, {}
    modes = ModeEstimates.of(results.prescribed, estimate, results.true)
    if modes is not None:
        figures["modes"] = modes_figure(modes, results.run.truth_label)
    if results.prescribed.labels.connections and results.prescribed.shapes is None:
        figures["structure"] = structure_figure(results.prescribed)
    if any(str(name).startswith(("loss_", "weight_")) for name in estimate.history):
        figures["history"] = history_figure(estimate.history)
    if any(given.prescribed or given.unknown for given in estimate.parameters):
        figures["parameters"] = parameters_figure(estimate.parameters, truth.parameters)
    if estimate.correlation is not None and len(estimate.parameters) > 1 and any_unknown(estimate.parameters):
        figures["correlation"] = correlation_figure(estimate.parameters, estimate.correlation)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]


def write_record_figures(results: Results, directory: Path | str) -> list[Path]:
    """Those that are about one record.

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
        "drift": drift_figure(Drifts.of(results.prescribed, estimate, truth.response), run.truth_label),
    }
    forces = ConnectionForces.of(results.prescribed, estimate, truth)
    if forces is not None and forces.memory.size:
        figures["hysteresis"] = hysteresis_figure(forces, run.truth_label)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]


def write_validation_figure(run: ValidationRun, estimate: Estimate, directory: Path) -> list[Path]:
    """Draw and save ``validation``, of a run of the identified system on other data; the files written."""
    return save(validation_figure(run, estimate), directory, "validation")


def write_posterior_figures(results: Results, groups: Mapping[str, xr.Dataset], directory: Path) -> list[Path]:
    """Draw and save ``posterior_pairs`` and, where there is something to draw, ``trace``, ``ranks``, ``fitted_force``.

    Traces and ranks are those of the parameters with the fewest effective draws; draws that did not come step by step
    have neither.

    Args:
        results: With a posterior.
        groups: Of ``posterior.nc``.
        directory: Of the figures.

    Returns:
        The files written.
    """
    posterior, draws = results.posterior, groups["posterior"]
    if posterior is None:
        return []
    parameters = [found.parameter for found in results.estimate.parameters]
    figures = {"posterior_pairs": posterior_pairs_figure(draws, parameters, results.truth.parameters)}
    if "sample_stats" in groups:
        worst = worst_sampled(posterior.diagnostics.head(len(parameters)), IN_TRACES)
        shown = [parameter for parameter in parameters if parameter.name in worst]
        figures["trace"] = trace_figure(draws, groups["sample_stats"], shown, len(parameters))
        figures["ranks"] = rank_figure(draws, shown, len(parameters))
    if posterior.predictive is not None:
        force_dofs = posterior.samples.force_dofs
        figures["fitted_force"] = force_predictive_figure(posterior.predictive, results.record, force_dofs)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]
