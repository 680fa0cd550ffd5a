"""What ``make paper``, ``table2``, ``figures``, ``seeds`` and ``nonlinearity`` do: first what is missing is made."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pinn_cli.paper.cases import TABLES, PlannedRun, planned_runs
from pinn_cli.paper.comparison import paper_tables, write_tables
from pinn_cli.paper.figures import copy_figures, paper_figures
from pinn_cli.paper.nonlinearity import NonlinearityScores, nonlinearity_realisations
from pinn_cli.paper.realisations import Solver, solve, solve_missing
from pinn_cli.paper.report import write_report
from pinn_cli.paper.runs import FinishedRun, Runner, make_runs, read_runs, run_case
from pinn_cli.paper.seeds import SeedScores, seed_realisations
from pinn_cli.runs.machine import usable_cores


def make_paper(output: Path, runner: Runner = run_case) -> int:
    """Make the runs that are missing, then tables, figures and report.

    Args:
        output: Folder of all of it; the runs lie in ``<output>/runs``.
        runner: Makes a run; by default `pinn-run` in a process of its own.

    Returns:
        0, or 1 if a run failed: what could be made without it is there nevertheless.
    """
    runs, failures = _made(planned_runs(), output, runner)
    print(write_report(runs, failures, output))
    return 1 if failures else 0


def make_table(name: str, output: Path, runner: Runner = run_case) -> int:
    """Make the runs of one table, where they are missing; write and print it; as `make_paper`."""
    chosen = [table for table in TABLES if table.name == name]
    runs, failures = _made(planned_runs(chosen), output, runner)
    tables = paper_tables(runs, chosen)
    write_tables(tables, output / "tables")
    print(f"\n{tables[0].sheet.markdown}\n\n{output / 'tables' / name}.csv")
    return 1 if failures else 0


def make_figures(output: Path, runner: Runner = run_case) -> int:
    """Make the runs that draw a figure, where they are missing, and copy the figures; as `make_paper`."""
    needed = {figure.run for figure in paper_figures()}
    runs, failures = _made([run for run in planned_runs() if run.name in needed], output, runner)
    copy_figures(runs, output / "figures")
    print(output / "figures")
    return 1 if failures else 0


def _made(planned: Sequence[PlannedRun], output: Path, runner: Runner) -> tuple[list[FinishedRun], list[str]]:
    return make_runs(planned, output / "runs", runner, at_once=len(usable_cores()))


def make_seeds(output: Path, solver: Solver = solve) -> int:
    """Solve the cases of Tables 2 and 5 over the noise seeds, where that is missing; rewrite the report.

    Args:
        output: As of `make_paper`; the results lie in ``<output>/seeds``.
        solver: Solves one realisation; by default with network and smoother, in this process.

    Returns:
        0, or 1 if one failed.
    """
    scored = solve_missing(seed_realisations(), output / "seeds" / "runs", solver)
    print(SeedScores.of(scored).write(output / "seeds"))
    _rewrite_report(output)
    return 1 if scored.failures or scored.missing else 0


def make_nonlinearity(output: Path, solver: Solver = solve) -> int:
    """The same over nonlinearity and force, in ``<output>/nonlinearity``; a training that diverges is a finding."""
    scored = solve_missing(nonlinearity_realisations(), output / "nonlinearity" / "runs", solver)
    scores = NonlinearityScores.of(scored)
    print(scores.write(output / "nonlinearity"))
    if not _rewrite_report(output):
        scores.draw(output / "nonlinearity")
    return 1 if scored.missing else 0


def make_all(output: Path) -> int:
    """The paper, the seeds and the nonlinearity; the largest of their statuses."""
    return max([make(output) for make in (make_paper, make_seeds, make_nonlinearity)])


def _rewrite_report(output: Path) -> bool:
    """Whether there is a report with what has been added: it is written from runs that are all there."""
    planned = planned_runs()
    runs = read_runs(planned, output / "runs")
    if len(runs) < len(planned):
        print(f"{output / 'report.html'} waits for runs that are missing or out of date: `make paper` makes them")
        return False
    print(write_report(runs, [], output))
    return True
