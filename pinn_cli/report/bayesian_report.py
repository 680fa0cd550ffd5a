"""What a sampled posterior leaves behind, beyond the files of every run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.report.figures.force_predictive import force_predictive_figure
from pinn_cli.report.figures.posterior_pairs import posterior_pairs_figure
from pinn_cli.report.figures.posterior_trace import PARAMETERS_SHOWN, rank_figure, trace_figure
from pinn_cli.report.figures.style import save
from pinn_cli.report.posterior_data import posterior_groups, write_posterior_data
from pinn_cli.report.posterior_table import diagnostics_table, worst_sampled
from pinn_cli.report.terminal import diagnostics_text
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np

    from pinn_cli.posterior.findings import PosteriorFindings
    from pinn_cli.record.record import Record


def write_posterior(
    findings: PosteriorFindings,
    record: Record,
    true: Mapping[str, np.ndarray] | None,
    labels: Mapping[str, object],
    units: Mapping[str, str],
    directory: Path,
    figures: bool = True,
) -> str:
    """Write ``posterior.nc``, ``diagnostics.csv`` and the posterior's figures; each is there whole or not at all.

    Args:
        findings: The draws, their diagnostics and verdict, and the force's posterior predictive where there is one.
        record: What the sampler's likelihood was made from.
        true: Symbol to values (dof,), marked in the figures; or None.
        labels: A value for each of `pinn_cli.report.labels.LABELS`.
        units: Symbol of a parameter to its unit, powers as ``m^3``.
        directory: Of the run.
        figures: Whether to draw them.

    Returns:
        The table of diagnostics and the verdict, as text.
    """
    write_posterior_data(posterior_groups(findings, record, units, labels), directory / "posterior.nc")
    write_table(diagnostics_table(findings.diagnostics, labels), directory / "diagnostics.csv")
    if figures:
        write_posterior_figures(findings, record, true, units, directory / "figures")
    return diagnostics_text(findings.diagnostics, findings.verdict)


def write_posterior_figures(
    findings: PosteriorFindings,
    record: Record,
    true: Mapping[str, np.ndarray] | None,
    units: Mapping[str, str],
    directory: Path,
) -> list[Path]:
    """Draw and save ``posterior_pairs`` and, where there is something to draw, ``trace``, ``ranks``, ``fitted_force``.

    Traces and ranks are those of the parameters with the fewest effective draws; draws that did not come step by step
    have neither.

    Returns:
        The files written.
    """
    samples = findings.samples
    figures = {"posterior_pairs": posterior_pairs_figure(samples, true, units)}
    if samples.statistics:
        parameters = findings.diagnostics[findings.diagnostics["parameter"].isin(samples.names)]
        shown = worst_sampled(parameters, PARAMETERS_SHOWN)
        figures["trace"] = trace_figure(samples, units, shown)
        figures["ranks"] = rank_figure(samples, shown)
    if findings.predictive is not None:
        figures["fitted_force"] = force_predictive_figure(findings.predictive, record, samples.force_dofs)
    return [path for name, figure in figures.items() for path in save(figure, directory, name)]
