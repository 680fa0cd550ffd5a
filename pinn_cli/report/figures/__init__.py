"""The figures of a run. Importing this package imports matplotlib; do so when a run has something to draw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from pinn_cli.report.estimates import ModeEstimates, connection_forces, drifts, restoring_curves
from pinn_cli.report.figures import connections, histories, posterior, sensors
from pinn_cli.report.figures import parameters as of_parameters
from pinn_cli.report.figures.structure import structure_figure
from pinn_cli.report.figures.style import save
from pinn_cli.report.parameters import worst_sampled
from pinn_cli.report.results import Results, record_folder
from pinn_cli.runs.side_by_side import shared_out
from pinn_cli.training.estimate import estimated_structure

if TYPE_CHECKING:
    import xarray as xr

# Figures that a run has something for, by name: of about how many panels, and how each is built.
Builders = dict[str, tuple[int, Callable[[], Figure]]]


def write_figures(results: Results, directory: Path | str, part: int = 0, of: int = 1) -> list[Path]:
    """Draw and save one of several parts of a run's figures that are about as much work; the files written.

    Of several records each has figures of its own. Parts are counted from 0.
    """
    folders = [(record_folder(i), record_figures(of_record)) for i, of_record in enumerate(results.by_record, start=1)]
    drawings = [
        (Path(directory) / folder / "figures", name, panels, build)
        for folder, builders in [*folders, (".", run_figures(results))]
        for name, (panels, build) in builders.items()
    ]
    share = [drawings[i] for i in shared_out([panels for _, _, panels, _ in drawings], of)[part]]
    return [path for place, name, _, build in share for path in save(build(), place, name)]


def run_figures(results: Results) -> Builders:
    """Those that are about parameters and training, which several records have in common."""
    estimate, prescribed, true = results.estimate, results.prescribed, results.truth.parameters
    parameters, modes = estimate.parameters, ModeEstimates.of(prescribed, estimate, results.true)
    builders: Builders = {}
    if modes is not None:
        builders["modes"] = len(modes.table), partial(of_parameters.modes_figure, modes, results.run.truth_label)
    if prescribed.labels.connections and not prescribed.is_modal:
        builders["structure"] = 2, partial(structure_figure, prescribed)
    if any(str(name).startswith(("loss_", "weight_")) for name in estimate.history):
        builders["history"] = 5, partial(sensors.history_figure, estimate.history)
    if any(given.prescribed or given.unknown for given in parameters):
        builders["parameters"] = 4, partial(of_parameters.parameters_figure, parameters, true)
    if estimate.correlation is not None and len(parameters) > 1 and any(p.unknown for p in parameters):
        builders["correlation"] = 2, partial(of_parameters.correlation_figure, parameters, estimate.correlation)
    return builders


def record_figures(results: Results) -> Builders:
    """Those that are about one record."""
    estimate, record, truth, prescribed = results.estimate, results.record, results.truth, results.prescribed
    rows, label = len(histories.shown_dofs(record.ndof)), results.run.truth_label
    builders: Builders = {
        "response": (5 * rows, partial(histories.response_figure, results)),
        "error_map": (8, partial(histories.error_map_figure, estimate, record, truth.response)),
    }
    if sensors.compared_channels(estimate, record):
        builders["residuals"] = 12, partial(sensors.residuals_figure, estimate, record)
    if record.band is not None:
        estimated = estimated_structure(prescribed, estimate.parameters)
        builders["frequency_response"] = 6, partial(sensors.frequency_response_figure, record, estimated)
    stretched, forces = drifts(prescribed, estimate, truth.response), connection_forces(prescribed, estimate, truth)
    if stretched.places:
        builders["drift"] = 2 * rows, partial(connections.drift_figure, stretched, label, results.shown)
    if (discrepancy := connections.Discrepancy.of(results)) is not None:
        builders["discrepancy"] = 4, partial(connections.discrepancy_figure, discrepancy)
    if curves := restoring_curves(results):
        builders["restoring"] = len(curves), partial(connections.restoring_figure, curves, label)
    if forces is not None and len(prescribed.memory):
        memory = np.searchsorted(prescribed.added, np.unique(prescribed.memory))
        builders["hysteresis"] = rows, partial(connections.hysteresis_figure, stretched, forces, memory, label)
    return builders


def write_posterior_figures(results: Results, groups: Mapping[str, xr.Dataset], directory: Path) -> list[Path]:
    """Draw and save ``posterior_pairs`` and, where there is something to draw, ``trace``, ``ranks``, ``fitted_force``.

    Traces and ranks are those of the parameters with the fewest effective draws; draws that did not come step by step
    have neither. ``groups`` are those of ``posterior.nc``.
    """
    sampled, draws = results.posterior, groups["posterior"]
    assert sampled is not None
    parameters = [p.parameter for p in results.estimate.parameters]
    figures = {"posterior_pairs": posterior.posterior_pairs_figure(draws, parameters, results.truth.parameters)}
    if "sample_stats" in groups:
        worst = worst_sampled(sampled.diagnostics.head(len(parameters)), posterior.IN_TRACES)
        shown = [parameter for parameter in parameters if parameter.name in worst]
        figures["trace"] = posterior.trace_figure(draws, groups["sample_stats"], shown, len(parameters))
        figures["ranks"] = posterior.rank_figure(draws, shown, len(parameters))
    if sampled.predictive is not None:
        force_dofs = sampled.samples.force_dofs
        figures["fitted_force"] = posterior.force_predictive_figure(sampled.predictive, results.record, force_dofs)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]
