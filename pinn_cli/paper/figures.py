"""The paper's Figures 1 to 14: three drawn, eleven from runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.paper.chain_drawing import chain_figure
from pinn_cli.paper.domain_drawing import domain_figure
from pinn_cli.paper.figure_list import PAPER_FIGURES, PaperFigure
from pinn_cli.paper.framework_drawing import framework_figure
from pinn_cli.paper.plan import SMOOTHER
from pinn_cli.paper.saved_run import read_posterior, read_response, read_true_parameters
from pinn_cli.report.figures import style
from pinn_cli.report.figures.error_map import error_map_figure
from pinn_cli.report.figures.posterior_pairs import posterior_pairs_figure
from pinn_cli.report.figures.response import response_figure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from pinn_cli.record.record import Response


def draw_figures(runs: Mapping[str, Path], directory: Path, figures: Sequence[PaperFigure] = PAPER_FIGURES) -> set[int]:
    """Draw and save figures as PNG and PDF, ``figure01`` and so on.

    Args:
        runs: Directory of each run that is there, by name; figures of other runs are left out.
        directory: Of the files; created where it is missing.
        figures: Which.

    Returns:
        The numbers of those drawn.
    """
    drawn = set()
    for figure in figures:
        if figure.run and figure.run not in runs:
            continue
        style.save(draw(figure, runs.get(figure.run)), directory, figure.name)
        drawn.add(figure.number)
    return drawn


def draw(figure: PaperFigure, run: Path | None) -> Figure:
    """Draw one figure from the directory of its run.

    Raises:
        OSError: A file of the run is missing.
        ValueError: A figure of a run, and no run.
    """
    drawings = {"chain": chain_figure, "framework": framework_figure, "domains": domain_figure}
    if figure.kind in drawings:
        return drawings[figure.kind]()
    if run is None:
        raise ValueError(f"{figure.name} is drawn from a run, and none was given")
    if figure.kind == "pairs":
        samples, units = read_posterior(run / "posterior.nc")
        return posterior_pairs_figure(samples, read_true_parameters(run / "parameters.csv"), units)
    saved = read_response(run / "response.nc", (SMOOTHER.name,))
    if figure.kind == "error_map":
        return error_map_figure(saved.estimate, saved.record, saved.truth)
    linear = equivalent_linear(figure.case) if figure.case.endswith("_linear") else None
    smoothed = saved.baselines.get(SMOOTHER.name)
    beside = None if smoothed is None else (SMOOTHER.title, smoothed)
    return response_figure(saved.estimate, saved.record, saved.truth, linear, baseline=beside)


def equivalent_linear(case: str) -> Response:
    """The true response of the case's linearised chain: runs draw it but do not keep it, so it is simulated again."""
    from hydra import compose, initialize_config_module

    from pinn_cli.cli.config import RunConfig

    with initialize_config_module("pinn_cli.conf", version_base="1.3"):
        config = RunConfig.read(compose("config", overrides=[f"experiment=paper/{case}"]))
    true, _ = config.model_error.chains(config.chain)
    return config.source.measure(true.linearised()).truth.response
