"""The figures of a run. Importing this package imports matplotlib; do so when a run has something to draw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.report.connection_forces import ConnectionForces
from pinn_cli.report.discrepancy import Discrepancy
from pinn_cli.report.drift import Drifts
from pinn_cli.report.figures.correlation import correlation_figure
from pinn_cli.report.figures.discrepancy import discrepancy_figure
from pinn_cli.report.figures.drift import drift_figure
from pinn_cli.report.figures.error_map import error_map_figure
from pinn_cli.report.figures.force_predictive import force_predictive_figure
from pinn_cli.report.figures.frequency_response import frequency_response_figure
from pinn_cli.report.figures.history import history_figure
from pinn_cli.report.figures.hysteresis import hysteresis_figure
from pinn_cli.report.figures.modes import modes_figure
from pinn_cli.report.figures.over_time import over_time_figure
from pinn_cli.report.figures.parameters import parameters_figure
from pinn_cli.report.figures.posterior import IN_TRACES, posterior_pairs_figure, rank_figure, trace_figure
from pinn_cli.report.figures.residuals import residuals_figure
from pinn_cli.report.figures.response import response_figure, shown_dofs
from pinn_cli.report.figures.structure import structure_figure
from pinn_cli.report.figures.style import save
from pinn_cli.report.figures.validation import validation_figure
from pinn_cli.report.modes import ModeEstimates
from pinn_cli.report.parameters import any_unknown
from pinn_cli.report.posterior import worst_sampled
from pinn_cli.report.record_report import record_folder
from pinn_cli.runs.side_by_side import shared_out
from pinn_cli.training.estimated_structure import estimated_structure

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from pinn_cli.report.results import Results
    from pinn_cli.report.validation_run import ValidationRun
    from pinn_cli.training.estimate import Estimate


@dataclass(frozen=True)
class Drawing:
    """A figure that a run has something for.

    Attributes:
        directory: Of its files.
        name: Of its files, without a suffix.
        build: Makes it.
        panels: About so many, which its time grows with.
    """

    directory: Path
    name: str
    build: Callable[[], Figure]
    panels: int

    def save(self) -> list[Path]:
        """Draw it; the files written."""
        return save(self.build(), self.directory, self.name)


def write_figures(results: Results, directory: Path | str, part: int = 0, of: int = 1) -> list[Path]:
    """Draw and save figures of a run, as PNG and PDF.

    Args:
        results: Of the run; of several records each has figures of its own.
        directory: Of the run.
        part: Which of the figures, from 0: those that are about as much work as each other part.
        of: How many parts there are.

    Returns:
        The files written.
    """
    drawings: list[Drawing] = []
    for number, own in enumerate(results.by_record, start=1):
        drawings += record_drawings(own, Path(directory) / record_folder(number) / "figures")
    drawings += run_drawings(results, Path(directory) / "figures")
    share = shared_out([drawing.panels for drawing in drawings], of)[part]
    return [path for i in share for path in drawings[i].save()]


def run_drawings(results: Results, directory: Path) -> list[Drawing]:
    """Those that are about parameters and training, which several records have in common."""
    estimate, truth = results.estimate, results.truth
    found: list[tuple[str, int, Callable[[], Figure]]] = []
    modes = ModeEstimates.of(results.prescribed, estimate, results.true)
    if modes is not None:
        found.append(("modes", modes.count, partial(modes_figure, modes, results.run.truth_label)))
    if results.prescribed.labels.connections and not results.prescribed.is_modal:
        found.append(("structure", 2, partial(structure_figure, results.prescribed)))
    if any(str(name).startswith(("loss_", "weight_")) for name in estimate.history):
        found.append(("history", 5, partial(history_figure, estimate.history)))
    if any(given.prescribed or given.unknown for given in estimate.parameters):
        found.append(("parameters", 4, partial(parameters_figure, estimate.parameters, truth.parameters)))
    if estimate.correlation is not None and len(estimate.parameters) > 1 and any_unknown(estimate.parameters):
        correlation = partial(correlation_figure, estimate.parameters, estimate.correlation)
        found.append(("correlation", 2, correlation))
    return [Drawing(directory, name, build, panels) for name, panels, build in found]


def record_drawings(results: Results, directory: Path) -> list[Drawing]:
    """Those that are about one record."""
    estimate, record, truth, run = results.estimate, results.record, results.truth, results.run
    baseline = (run.baseline, results.baseline.response) if results.baseline else None
    response = partial(
        response_figure, estimate, record, truth.response, results.linear_response, run.truth_label, baseline
    )
    rows = len(shown_dofs(record.ndof))
    drifts = Drifts.of(results.prescribed, estimate, truth.response)
    found: list[tuple[str, int, Callable[[], Figure]]] = [
        ("response", 5 * rows, response),
        ("residuals", 12, partial(residuals_figure, estimate, record)),
        ("error_map", 8, partial(error_map_figure, estimate, record, truth.response)),
    ]
    if record.band is not None:
        estimated = estimated_structure(results.prescribed, estimate.parameters)
        found.append(("frequency_response", 6, partial(frequency_response_figure, record, estimated)))
    if drifts.names:
        found.append(("drift", 2 * rows, partial(drift_figure, drifts, run.truth_label)))
    discrepancy = Discrepancy.of(results)
    if discrepancy is not None:
        found.append(("discrepancy", 4, partial(discrepancy_figure, discrepancy)))
    forces = ConnectionForces.of(results.prescribed, estimate, truth)
    if forces is not None and forces.memory.size:
        found.append(("hysteresis", rows, partial(hysteresis_figure, forces, run.truth_label)))
    return [Drawing(directory, name, build, panels) for name, panels, build in found]


def write_validation_figure(run: ValidationRun, estimate: Estimate, directory: Path) -> list[Path]:
    """Draw and save ``validation``, of a run of the identified system on other data; the files written."""
    return save(validation_figure(run, estimate), directory, "validation")


def write_over_time_figure(table: pd.DataFrame, directory: Path) -> list[Path]:
    """Draw and save ``parameters_over_time``; the files written."""
    return save(over_time_figure(table), directory, "parameters_over_time")


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
