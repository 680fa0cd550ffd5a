"""The figures of a run. Importing this package imports matplotlib; do so when a run has something to draw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pinn_cli.report.estimates import ModeEstimates, connection_forces, drifts
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
from pinn_cli.report.restoring import restoring_curves
from pinn_cli.report.results import Results, record_folder
from pinn_cli.runs.side_by_side import shared_out
from pinn_cli.training.estimated_structure import estimated_structure

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "Drawing", "correlation_figure", "error_map_figure", "history_figure", "over_time_figure", "parameters_figure",
    "record_drawings", "residuals_figure", "response_figure", "run_drawings", "save", "validation_figure",
    "write_figures", "write_over_time_figure", "write_posterior_figures",
]  # fmt: skip


@dataclass(frozen=True)
class Drawing:
    """A figure that a run has something for: where its files lie, and how it is built of about so many panels."""

    directory: Path
    name: str
    panels: int
    build: Callable[[], Figure]


def write_figures(results: Results, directory: Path | str, part: int = 0, of: int = 1) -> list[Path]:
    """Draw and save one of several parts of a run's figures that are about as much work; the files written.

    Of several records each has figures of its own. Parts are counted from 0.
    """
    drawings: list[Drawing] = []
    for number, of_record in enumerate(results.by_record, start=1):
        drawings += record_drawings(of_record, Path(directory) / record_folder(number) / "figures")
    drawings += run_drawings(results, Path(directory) / "figures")
    share = [drawings[i] for i in shared_out([drawing.panels for drawing in drawings], of)[part]]
    return [path for drawing in share for path in save(drawing.build(), drawing.directory, drawing.name)]


def run_drawings(results: Results, directory: Path) -> list[Drawing]:
    """Those that are about parameters and training, which several records have in common."""
    estimate, prescribed, true = results.estimate, results.prescribed, results.truth.parameters
    parameters, modes = estimate.parameters, ModeEstimates.of(prescribed, estimate, results.true)
    builders: dict[str, tuple[int, Callable[[], Figure]]] = {}
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
    return [Drawing(directory, name, *how) for name, how in builders.items()]


def record_drawings(results: Results, directory: Path) -> list[Drawing]:
    """Those that are about one record."""
    estimate, record, truth, prescribed = results.estimate, results.record, results.truth, results.prescribed
    rows, label = len(shown_dofs(record.ndof)), results.run.truth_label
    builders: dict[str, tuple[int, Callable[[], Figure]]] = {
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
        memory = np.searchsorted(prescribed.added, prescribed.memory)
        builders["hysteresis"] = rows, partial(hysteresis_figure, stretched, forces, memory, label)
    return [Drawing(directory, name, *how) for name, how in builders.items()]


def write_over_time_figure(table: pd.DataFrame, directory: Path, of: str = "Record") -> list[Path]:
    """Draw and save ``parameters_over_time``; the files written."""
    return save(over_time_figure(table, of), directory, "parameters_over_time")


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
