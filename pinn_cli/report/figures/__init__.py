"""The figures of a run. Importing this package imports matplotlib; do so when a run has something to draw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from pinn_cli.report.estimates import ModeEstimates, connection_forces, drifts, restoring_curves
from pinn_cli.report.figures.connections import (
    Discrepancy,
    discrepancy_figure,
    drift_figure,
    hysteresis_figure,
    restoring_figure,
)
from pinn_cli.report.figures.histories import error_map_figure, response_figure, shown_dofs
from pinn_cli.report.figures.parameters import correlation_figure, modes_figure, over_time_figure, parameters_figure
from pinn_cli.report.figures.posterior import (
    IN_TRACES,
    force_predictive_figure,
    posterior_pairs_figure,
    rank_figure,
    trace_figure,
)
from pinn_cli.report.figures.sensors import (
    compared_channels,
    frequency_response_figure,
    history_figure,
    residuals_figure,
    validation_figure,
)
from pinn_cli.report.figures.structure import structure_figure
from pinn_cli.report.figures.style import save
from pinn_cli.report.parameters import worst_sampled
from pinn_cli.report.results import Results, record_folder
from pinn_cli.runs.side_by_side import shared_out
from pinn_cli.training.estimated_structure import estimated_structure

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "correlation_figure", "error_map_figure", "history_figure", "over_time_figure", "parameters_figure",
    "record_figures", "residuals_figure", "response_figure", "run_figures", "save", "validation_figure",
    "write_figures", "write_posterior_figures",
]  # fmt: skip

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
        builders["modes"] = modes.count, partial(modes_figure, modes, results.run.truth_label)
    if prescribed.labels.connections and not prescribed.is_modal:
        builders["structure"] = 2, partial(structure_figure, prescribed)
    if any(str(name).startswith(("loss_", "weight_")) for name in estimate.history):
        builders["history"] = 5, partial(history_figure, estimate.history)
    if any(given.prescribed or given.unknown for given in parameters):
        builders["parameters"] = 4, partial(parameters_figure, parameters, true)
    if estimate.correlation is not None and len(parameters) > 1 and any(p.unknown for p in parameters):
        builders["correlation"] = 2, partial(correlation_figure, parameters, estimate.correlation)
    return builders


def record_figures(results: Results) -> Builders:
    """Those that are about one record."""
    estimate, record, truth, prescribed = results.estimate, results.record, results.truth, results.prescribed
    rows, label = len(shown_dofs(record.ndof)), results.run.truth_label
    builders: Builders = {
        "response": (5 * rows, partial(response_figure, results)),
        "error_map": (8, partial(error_map_figure, estimate, record, truth.response)),
    }
    if compared_channels(estimate, record):
        builders["residuals"] = 12, partial(residuals_figure, estimate, record)
    if record.band is not None:
        estimated = estimated_structure(prescribed, estimate.parameters)
        builders["frequency_response"] = 6, partial(frequency_response_figure, record, estimated)
    stretched, forces = drifts(prescribed, estimate, truth.response), connection_forces(prescribed, estimate, truth)
    if stretched.places:
        builders["drift"] = 2 * rows, partial(drift_figure, stretched, label, results.shown)
    if (discrepancy := Discrepancy.of(results)) is not None:
        builders["discrepancy"] = 4, partial(discrepancy_figure, discrepancy)
    if curves := restoring_curves(results):
        builders["restoring"] = len(curves), partial(restoring_figure, curves, label)
    if forces is not None and len(prescribed.memory):
        memory = np.searchsorted(prescribed.added, np.unique(prescribed.memory))
        builders["hysteresis"] = rows, partial(hysteresis_figure, stretched, forces, memory, label)
    return builders


def write_posterior_figures(results: Results, groups: Mapping[str, xr.Dataset], directory: Path) -> list[Path]:
    """Draw and save ``posterior_pairs`` and, where there is something to draw, ``trace``, ``ranks``, ``fitted_force``.

    Traces and ranks are those of the parameters with the fewest effective draws; draws that did not come step by step
    have neither. ``groups`` are those of ``posterior.nc``.
    """
    posterior, draws = results.posterior, groups["posterior"]
    assert posterior is not None
    parameters = [p.parameter for p in results.estimate.parameters]
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
