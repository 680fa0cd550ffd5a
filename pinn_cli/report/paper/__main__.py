"""``python -m pinn_cli.report.paper [all|figures] [--output outputs/paper]``: what ``make paper`` runs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.report.paper.figure_list import PAPER_FIGURES
from pinn_cli.report.paper.plan import planned_runs
from pinn_cli.report.paper.runs import make_runs
from pinn_cli.report.run_record import package_versions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.report.paper.runs import FinishedRun, Runner


def make_paper(output: Path, runner: Runner | None = None) -> int:
    """Make the runs that are missing, then tables, figures and report.

    Args:
        output: Folder of all of it; the runs lie in ``<output>/runs``.
        runner: Makes a run; None: `pinn-run` in a process of its own.

    Returns:
        0, or 1 if a run failed: what could be made without it is there nevertheless.
    """
    # pandas, torch and matplotlib are wanted once the runs are there: --help need not wait for them.
    from pinn_cli.report.paper.report import ReportContent, write_report
    from pinn_cli.report.paper.tables import paper_tables, write_tables

    runs, failures = _runs(output, None, runner)
    tables = paper_tables(runs)
    write_tables(tables, output / "tables")
    images = _figures(runs, output)
    content = ReportContent(runs, failures, tables, PAPER_FIGURES, images, package_versions())
    print(write_report(content, output / "report.html"))
    return 1 if failures else 0


def make_figures(output: Path, runner: Runner | None = None) -> int:
    """Make the runs that a figure is drawn from, where they are missing, and draw the figures; as `make_paper`."""
    runs, failures = _runs(output, {figure.run for figure in PAPER_FIGURES}, runner)
    _figures(runs, output)
    print(output / "figures")
    return 1 if failures else 0


def _runs(output: Path, names: set[str] | None, runner: Runner | None) -> tuple[list[FinishedRun], list[str]]:
    planned = [run for run in planned_runs() if names is None or run.name in names]
    return make_runs(planned, output / "runs", **({"runner": runner} if runner else {}))


def _figures(runs: Sequence[FinishedRun], output: Path) -> dict[int, Path]:
    from pinn_cli.report.paper.figures import draw_figures

    directory = output / "figures"
    drawn = draw_figures({run.planned.name: run.directory for run in runs}, directory)
    return {figure.number: directory / f"{figure.name}.png" for figure in PAPER_FIGURES if figure.number in drawn}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; the exit status is 1 if a run failed, 130 if it was interrupted."""
    parser = argparse.ArgumentParser(prog="python -m pinn_cli.report.paper", description=__doc__)
    parser.add_argument("what", nargs="?", choices=("all", "figures"), default="all")
    parser.add_argument("--output", type=Path, default=Path("outputs/paper"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    try:
        return (make_paper if given.what == "all" else make_figures)(given.output)
    except KeyboardInterrupt:
        print("interrupted: the same command goes on with the runs that are missing", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
