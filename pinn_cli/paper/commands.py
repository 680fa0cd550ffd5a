"""What ``make paper``, ``table2``, ``figures``, ``seeds`` and ``nonlinearity`` do: first what is missing is made."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.paper.cases import TABLES, PlannedRun, planned_runs
from pinn_cli.paper.figures import copy_figures, paper_figures
from pinn_cli.paper.robustness.noise_seeds import make_seed_scores, read_seed_scores
from pinn_cli.paper.robustness.nonlinearity import make_nonlinearity_scores, read_nonlinearity_scores
from pinn_cli.paper.robustness.realisation import solve
from pinn_cli.paper.runs import make_runs, read_runs, run_case
from pinn_cli.paper.sheet_files import markdown

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pinn_cli.paper.robustness.scored import Solver
    from pinn_cli.paper.runs import FinishedRun, Runner

RUNS, TABLE_FILES, FIGURES, SEEDS, NONLINEARITY = "runs", "tables", "figures", "seeds", "nonlinearity"
REPORT = "report.html"


def make_paper(output: Path, runner: Runner = run_case) -> int:
    """Make the runs that are missing, then tables, figures and report.

    Args:
        output: Folder of all of it; the runs lie in ``<output>/runs``.
        runner: Makes a run; by default `pinn-run` in a process of its own.

    Returns:
        0, or 1 if a run failed: what could be made without it is there nevertheless.
    """
    runs, failures = make_runs(planned_runs(), output / RUNS, runner)
    _write_report(runs, failures, output)
    return 1 if failures else 0


def make_table(name: str, output: Path, runner: Runner = run_case) -> int:
    """Make the runs of one table, where they are missing; write and print it; as `make_paper`."""
    from pinn_cli.paper.tables import paper_tables, write_tables

    chosen = [table for table in TABLES if table.name == name]
    runs, failures = make_runs(planned_runs(chosen), output / RUNS, runner)
    tables = paper_tables(runs, chosen)
    write_tables(tables, output / TABLE_FILES)
    print(f"\n{markdown(tables[0].sheet)}\n\n{output / TABLE_FILES / name}.csv")
    return 1 if failures else 0


def make_figures(output: Path, runner: Runner = run_case) -> int:
    """Make the runs that draw a figure, where they are missing, and copy the figures; as `make_paper`."""
    needed = {figure.run for figure in paper_figures()}
    runs, failures = make_runs([run for run in planned_runs() if run.name in needed], output / RUNS, runner)
    copy_figures(_directories(runs), output / FIGURES)
    print(output / FIGURES)
    return 1 if failures else 0


def make_seeds(output: Path, solver: Solver = solve) -> int:
    """Solve the cases of Tables 2 and 5 over the noise seeds, where that is missing; rewrite the report.

    Args:
        output: As of `make_paper`; the results lie in ``<output>/seeds``.
        solver: Solves one realisation; by default with network and smoother, in this process.

    Returns:
        0, or 1 if one failed.
    """
    seeds = make_seed_scores(output / SEEDS, solver)
    print(output / SEEDS / "summary.csv")
    _rewrite_report(output)
    return 1 if seeds.scored.failures or seeds.scored.missing else 0


def make_nonlinearity(output: Path, solver: Solver = solve) -> int:
    """The same over nonlinearity and force, in ``<output>/nonlinearity``; a training that diverges is a finding."""
    from pinn_cli.paper.robustness.nonlinearity_figure import write_nonlinearity_figure

    scores = make_nonlinearity_scores(output / NONLINEARITY, solver)
    write_nonlinearity_figure(scores, output / NONLINEARITY)
    print(output / NONLINEARITY / "nonlinearity.csv")
    _rewrite_report(output)
    return 1 if scores.scored.missing else 0


def make_all(output: Path) -> int:
    """The paper, the seeds and the nonlinearity; the largest of their statuses."""
    return max([make(output) for make in (make_paper, make_seeds, make_nonlinearity)])


def _directories(runs: Sequence[FinishedRun]) -> dict[str, Path]:
    return {run.planned.name: run.directory for run in runs}


def _rewrite_report(output: Path) -> None:
    """The report with what has been added to it, from runs that are all there; without them nothing is written."""
    planned: list[PlannedRun] = planned_runs()
    runs = read_runs(planned, output / RUNS)
    if len(runs) < len(planned):
        print(f"{output / REPORT} waits for runs that are missing or out of date: `make paper` makes them")
        return
    _write_report(runs, [], output)


def _write_report(runs: Sequence[FinishedRun], failures: Sequence[str], output: Path) -> None:
    # matplotlib and torch are wanted once the runs are there: --help need not wait for them.
    from pinn_cli.paper.report import ReportContent, write_report
    from pinn_cli.paper.robustness.nonlinearity_figure import write_nonlinearity_figure
    from pinn_cli.paper.robustness.seed_sheets import seed_sheets
    from pinn_cli.paper.tables import paper_tables, write_sheets, write_tables

    tables = paper_tables(runs)
    write_tables(tables, output / TABLE_FILES)
    seeds, nonlinearity = read_seed_scores(output / SEEDS), read_nonlinearity_scores(output / NONLINEARITY)
    write_sheets(seed_sheets(seeds), output / SEEDS)
    images = copy_figures(_directories(runs), output / FIGURES)
    drawn = write_nonlinearity_figure(nonlinearity, output / NONLINEARITY)
    content = ReportContent(runs, failures, tables, images, seeds, nonlinearity, drawn)
    print(write_report(content, output / REPORT))
