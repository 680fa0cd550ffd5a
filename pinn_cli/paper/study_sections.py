"""The report's sections on noise seeds and on nonlinearity: there once their results are."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from pinn_cli.paper import sheet_files
from pinn_cli.paper.picture import picture
from pinn_cli.paper.plan import SMOOTHER
from pinn_cli.paper.study.noise_seeds import PINN
from pinn_cli.paper.study.nonlinearity_figure import CAPTION, TITLE
from pinn_cli.paper.study.seeds_sheet import seed_sheets

if TYPE_CHECKING:
    from pathlib import Path

    from pinn_cli.paper.study.noise_seeds import SeedStudy
    from pinn_cli.paper.study.nonlinearity import NonlinearityStudy
    from pinn_cli.paper.study.results import Results

SEEDS_WORDS = (
    "<p>A published value is one draw of the noise. Here every case of Tables 2 and 5 is estimated from other draws of "
    "the sensors' noise on the same motion, and the error is given as mean and spread. A mark compares the mean with "
    "the published error.</p>"
)


def seeds_section(study: SeedStudy) -> str:
    """Tables of mean and spread, how often the published fitness is reached on average, and what it took."""
    if study.empty:
        return "<p>Not there, or out of date: <code>make seeds</code> makes them.</p>"
    sheets = "\n".join(sheet_files.html(sheet) for sheet in seed_sheets(study))
    return f"{SEEDS_WORDS}\n{_reached(study)}\n{_taken(study.results, 'make seeds')}\n{sheets}"


def _reached(study: SeedStudy) -> str:
    """Cells of Tables 2 and 5 whose mean is at least the published value."""
    given = study.summary.dropna(subset=["published"])
    counts = []
    for estimator, title in ((PINN, "our"), (SMOOTHER.name, "the Kalman smoother's")):
        cells = given[given["estimator"] == estimator]
        if len(cells):
            good = int((cells["range_fitness_mean"].round(2) >= cells["published"].round(2)).sum())
            counts.append(f"{title} mean range fitness is at least the published value in {good} of {len(cells)} cells")
    text = "; ".join(counts)
    return f"<p>{text[:1].upper()}{text[1:]}.</p>"


def nonlinearity_section(study: NonlinearityStudy, image: Path | None) -> str:
    """The figure with its caption, and what it took."""
    if study.empty or image is None:
        return "<p>Not there, or out of date: <code>make nonlinearity</code> makes it.</p>"
    seeds = int(study.summary["seeds"].max())
    caption = f"<b>{escape(TITLE)}.</b> {escape(CAPTION.format(seeds=seeds))}"
    return f"{picture('nonlinearity-figure', image, TITLE, caption)}\n{_taken(study.results, 'make nonlinearity')}"


def _taken(results: Results, command: str) -> str:
    """How many there are, how long they took, and what failed."""
    count = len(results.found)
    told = f"{count} records, each estimated by both, in {results.seconds:.0f} s one after the other"
    missing = (
        f"; {len(results.missing)} more are missing or out of date (<code>{command}</code>)" if results.missing else ""
    )
    failed = "".join(f"<li>{escape(failure)}</li>" for failure in results.failures)
    return f"<p>{told}{missing}.</p>" + (
        f'<p class="worse">Without an estimate:</p><ul>{failed}</ul>' if failed else ""
    )
