"""``report.html``: the whole comparison in one file that needs no network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pinn_cli.paper.cases import SMOOTHER
from pinn_cli.paper.figures import paper_figures
from pinn_cli.paper.rendering import render
from pinn_cli.paper.robustness.realisation import PINN
from pinn_cli.paper.robustness.seed_sheets import seed_sheets
from pinn_cli.paper.shortfalls import shortfalls
from pinn_cli.report.run_record import package_versions
from pinn_cli.runs.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from pinn_cli.paper.robustness.noise_seeds import SeedScores
    from pinn_cli.paper.robustness.nonlinearity import NonlinearityScores
    from pinn_cli.paper.runs import FinishedRun
    from pinn_cli.paper.tables import PaperTable


@dataclass(frozen=True, eq=False)
class ReportContent:
    """All that the report shows.

    Attributes:
        runs: Those that are there.
        failures: What went wrong with the others.
        tables: In order.
        images: Number of a figure to its PNG or SVG file; a figure without one is said to be missing.
        seeds: Both estimators over the noise seeds; empty where that has not been made.
        nonlinearity: Both over the strength of the nonlinearity; likewise.
        nonlinearity_image: Its PNG file.
    """

    runs: Sequence[FinishedRun]
    failures: Sequence[str]
    tables: Sequence[PaperTable]
    images: Mapping[int, Path]
    seeds: SeedScores
    nonlinearity: NonlinearityScores
    nonlinearity_image: Path | None


def write_report(content: ReportContent, path: Path) -> Path:
    """Write the report: styles and images are in it, and it loads nothing. It is there whole or not at all."""
    text = render(
        "report.html",
        **vars(content),
        figures=paper_figures(),
        smoother=SMOOTHER.name,
        seed_sheets=seed_sheets(content.seeds),
        reached=_reached(content.seeds),
        identifiable=_identifiable(content.tables),
        without_smoother=_without_smoother(content.runs),
        shortfalls=shortfalls(content.tables, content.seeds),
        versions=package_versions(),
    )
    return write_text(text, path)


def _reached(seeds: SeedScores) -> list[tuple[str, int, int]]:
    """Whose, in how many cells of Tables 2 and 5 the mean is at least the published value, and of how many."""
    if seeds.empty:
        return []
    given = seeds.summary.dropna(subset=["published"])
    good = given["range_fitness_mean"].round(2) >= given["published"].round(2)
    whose = {PINN: "Our", SMOOTHER.name: "The Kalman smoother's"}
    counts = ((text, good[given["estimator"] == name]) for name, text in whose.items())
    return [(text, int(cells.sum()), len(cells)) for text, cells in counts if len(cells)]


def _identifiable(tables: Sequence[PaperTable]) -> dict[Any, Any] | None:
    """The row of kappa_2 at 10 dB with the uncertainty that the run found; None where there is no such run."""
    for table in tables:
        rows = table.comparison
        if "larger_error" in rows:
            ours = rows[(rows["case"] == "sp_5dof_snr10") & (rows["parameter"] == "kappa_2")]
            ours = ours[(ours["variant"] == table.default) & ours["std"].notna()]
            for row in ours.to_dict("records"):
                return row
    return None


def _without_smoother(runs: Sequence[FinishedRun]) -> list[str]:
    """The cases where the smoother was asked for and found nothing."""
    return [
        run.planned.case
        for run in runs
        if SMOOTHER.name in " ".join(run.planned.variant.overrides)
        and SMOOTHER.name not in {found.variant for found in run.scores()}
    ]
