"""``report.html``: the whole comparison in one file that needs no network."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from pinn_cli.paper import sheet_files
from pinn_cli.paper.picture import picture
from pinn_cli.paper.plan import SMOOTHER
from pinn_cli.paper.report_text import INTRODUCTION, STYLE, fidelity
from pinn_cli.paper.shortfalls import counted, shortfalls
from pinn_cli.paper.study_sections import nonlinearity_section, seeds_section
from pinn_cli.runs.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from pinn_cli.paper.figure_list import PaperFigure
    from pinn_cli.paper.runs import FinishedRun
    from pinn_cli.paper.study.noise_seeds import SeedStudy
    from pinn_cli.paper.study.nonlinearity import NonlinearityStudy
    from pinn_cli.paper.tables import PaperTable

TITLE = "The paper's tables and figures, published and recomputed"


@dataclass(frozen=True, eq=False)
class ReportContent:
    """All that the report shows.

    Attributes:
        runs: Those that are there.
        failures: What went wrong with the others.
        tables: In order.
        figures: In order.
        images: Number of a figure to its PNG file; a figure without one is said to be missing.
        versions: Of Python and the packages.
        seeds: Both estimators over the noise seeds; empty where that has not been made.
        nonlinearity: Both over the strength of the nonlinearity; likewise.
        nonlinearity_image: Its PNG file.
    """

    runs: Sequence[FinishedRun]
    failures: Sequence[str]
    tables: Sequence[PaperTable]
    figures: Sequence[PaperFigure]
    images: Mapping[int, Path]
    versions: Mapping[str, str | None]
    seeds: SeedStudy
    nonlinearity: NonlinearityStudy
    nonlinearity_image: Path | None


def write_report(content: ReportContent, path: Path) -> Path:
    """Write the report; it is there whole or not at all."""
    return write_text(report_html(content), path)


def report_html(content: ReportContent) -> str:
    """The report as one HTML document: styles and images are in it, and it loads nothing."""
    sections = (
        ("tables", "Tables", "\n".join(sheet_files.html(table.sheet) for table in content.tables)),
        ("figures", "Figures", "\n".join(_figure(figure, content.images) for figure in content.figures)),
        ("seeds", "Over noise seeds", seeds_section(content.seeds)),
        (
            "nonlinearity", "How nonlinear the system may be",
            nonlinearity_section(content.nonlinearity, content.nonlinearity_image),
        ),
        ("fidelity", "What could not be matched, and why", _fidelity(content)),
        ("runs", "What was run", _runs(content)),
    )  # fmt: skip
    links = " · ".join(f'<a href="#{name}">{title}</a>' for name, title, _ in sections)
    body = "\n".join(f'<section id="{name}">\n<h2>{title}</h2>\n{text}\n</section>' for name, title, text in sections)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{TITLE}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{TITLE}</h1>\n"
        f"{INTRODUCTION}\n{_summary(content)}\n<nav>{links}</nav>\n{body}\n</main>\n</body>\n</html>"
    )


def _summary(content: ReportContent) -> str:
    rows = []
    for table in content.tables:
        worse, of = counted(table, table.default)
        smoother_worse, smoother_of = counted(table, SMOOTHER.name)
        if of:
            smoother = f"{smoother_of - smoother_worse} of {smoother_of}" if smoother_of else "no estimate"
            title = escape(table.sheet.title)
            rows.append(f'<tr><th scope="row">{title}</th><td>{of - worse} of {of}</td><td>{smoother}</td></tr>')
    failed = ""
    if content.failures:
        listed = "".join(f"<li>{escape(failure.splitlines()[0])}</li>" for failure in content.failures)
        failed = f'<p class="worse">Runs that failed; their cells are missing:</p><ul>{listed}</ul>'
    titles = "<th class=head>Values at least as good as the published ones</th><th>ours</th><th>Kalman smoother</th>"
    head = f"<tr>{titles}</tr>"
    counts = f'<div class="scroll"><table><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table></div>'
    return f"{failed}\n{counts}"


def _figure(figure: PaperFigure, images: Mapping[int, Path]) -> str:
    caption = f"<b>Figure {figure.number}: {escape(figure.title)}.</b> {escape(figure.caption)}"
    place = images.get(figure.number)
    if place is None:
        missing = f"<p>Not drawn: the run {escape(figure.run)} is missing.</p>"
        return f'<figure id="{figure.name}">\n{missing}\n<figcaption>{caption}</figcaption>\n</figure>'
    return picture(figure.name, place, figure.title, caption)


def _fidelity(content: ReportContent) -> str:
    words = f"{fidelity(content.tables)}\n{_without_smoother(content.runs)}"
    found = shortfalls(content.tables, content.seeds)
    if not found:
        return f"{words}\n<p>No value of ours is worse than the published one.</p>"
    rows = "\n".join(
        f'<tr><td>{escape(item.table)}</td><th scope="row">{escape(item.cell)}</th><td>{escape(item.published)}</td>'
        f'<td>{escape(item.ours)}</td><td class="text">{escape(item.reason)}</td></tr>'
        for item in found
    )
    head = (
        "<tr><th class=head>Table</th><th class=head>Cell</th><th>published</th><th>ours</th>"
        "<th class=head>why</th></tr>"
    )
    return (
        f"{words}\n<h3>Every value of ours that is worse than the published one: {len(found)}</h3>\n"
        f'<div class="scroll" tabindex="0"><table>\n<thead>{head}</thead>\n<tbody>\n{rows}\n</tbody>\n</table></div>'
    )


def _without_smoother(runs: Sequence[FinishedRun]) -> str:
    """Where the smoother was asked for and found nothing."""
    cases = [
        run.planned.case
        for run in runs
        if SMOOTHER.name in " ".join(run.planned.variant.overrides)
        and SMOOTHER.name not in {estimate.variant for estimate in run.estimates()}
    ]
    if not cases:
        return ""
    listed = escape(", ".join(cases))
    return f"<p><b>No smoother.</b> The Kalman smoother found no estimate of {listed}: the log of the run says why.</p>"


def _runs(content: ReportContent) -> str:
    rows = "\n".join(_run_row(run) for run in content.runs)
    total = sum(run.process_seconds for run in content.runs)
    versions = ", ".join(
        f"{escape(name)} {escape(str(version))}" for name, version in content.versions.items() if version
    )
    head = (
        "<tr><th class=head>Case</th><th class=head>variant</th><th>estimate (s)</th><th>posterior (s)</th>"
        "<th>smoother (s)</th><th>whole process (s)</th></tr>"
    )
    return (
        f"<p>{len(content.runs)} runs, {total:.0f} s one after the other, imports and each run's own figures included. "
        "Each is <code>pinn-run experiment=paper/&lt;case&gt;</code> with the settings below. A run is made again only "
        "when its configuration, the code or a package changes.</p>\n"
        f'<div class="scroll" tabindex="0"><table>\n<thead>{head}</thead>\n<tbody>\n{rows}\n</tbody>\n</table></div>\n'
        f"<p>Versions: {versions}.</p>"
    )


def _run_row(run: FinishedRun) -> str:
    seconds = run.record["seconds"]
    stages = [
        # A dash where nothing was done, which takes no time worth a digit.
        f"{seconds[name]:.1f}" if seconds.get(name, 0.0) >= 0.05 else "-"
        for name in ("estimate", "posterior", "baseline")
    ]
    variant = run.planned.variant
    settings = f"<br><code>{escape(' '.join(variant.overrides))}</code>" if variant.overrides else ""
    cells = "".join(f"<td>{text}</td>" for text in (*stages, f"{run.process_seconds:.1f}"))
    heads = f'<th scope="row">{escape(run.planned.case)}</th><th scope="row">{escape(variant.title)}{settings}</th>'
    return f"<tr>{heads}{cells}</tr>"
